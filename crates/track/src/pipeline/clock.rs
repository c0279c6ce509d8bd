//! What the stages' work takes.

#[cfg(not(target_family = "wasm"))]
pub(super) use std::time::Instant;

#[cfg(target_family = "wasm")]
pub(super) use nowhere::Instant;

/// WebAssembly without a system has no clock, and asking for one would end the program: all work takes no time.
#[cfg(target_family = "wasm")]
mod nowhere {
    use std::time::Duration;

    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Instant;

    impl Instant {
        pub(crate) fn now() -> Self {
            Self
        }

        pub(crate) fn elapsed(self) -> Duration {
            Duration::ZERO
        }
    }
}
