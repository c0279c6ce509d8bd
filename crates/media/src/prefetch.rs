//! Decoding ahead on another thread.

use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{Builder, JoinHandle};

use super::{ClipInfo, Frame, FrameError, FrameSource};

/// Runs a source on another thread, at most a given number of frames ahead of the reader. The thread starts when
/// the first frame is asked for.
///
/// Frames, their order and any error are those of the source itself.
pub struct Prefetch {
    info: ClipInfo,
    ahead: usize,
    max_side: Option<u32>,
    state: State,
    shortfall: Option<String>,
}

/// Gets the largest side that was asked for, and a place to hand frames over to: `false` when no one listens. Gives the
/// [`FrameSource::shortfall`].
type Producer =
    Box<dyn FnOnce(Option<u32>, &dyn Fn(Result<Frame, FrameError>) -> bool) -> Option<String> + Send>;

enum State {
    Waiting(Producer),
    Running { frames: Receiver<Result<Frame, FrameError>>, thread: JoinHandle<Option<String>> },
    Ended,
}

impl Prefetch {
    /// Reads `source`, keeping at most `ahead` decoded frames (at least one).
    pub fn new(mut source: impl FrameSource + 'static, ahead: usize) -> Self {
        let info = source.info().clone();
        Self::from_producer(info, ahead, move |max_side, send| {
            if let Some(side) = max_side {
                source.set_max_side(side);
            }
            while let Some(item) = source.next_frame().transpose() {
                let failed = item.is_err();
                if !send(item) || failed {
                    return None;
                }
            }
            source.shortfall()
        })
    }

    /// Reads what `produce` hands over until it is done or is told `false`: no one listens.
    pub(super) fn from_producer(
        info: ClipInfo,
        ahead: usize,
        produce: impl FnOnce(Option<u32>, &dyn Fn(Result<Frame, FrameError>) -> bool) -> Option<String>
        + Send
        + 'static,
    ) -> Self {
        let state = State::Waiting(Box::new(produce));
        Self { info, ahead: ahead.max(1), max_side: None, state, shortfall: None }
    }

    /// Starts the thread where it waits.
    fn start(&mut self) -> Result<(), FrameError> {
        let produce = match std::mem::replace(&mut self.state, State::Ended) {
            State::Waiting(produce) => produce,
            other => {
                self.state = other;
                return Ok(());
            }
        };
        let (sender, frames) = sync_channel(self.ahead);
        let max_side = self.max_side;
        let thread = Builder::new()
            .name("frames".to_owned())
            .spawn(move || produce(max_side, &|item| sender.send(item).is_ok()))
            .map_err(|source| FrameError::Io { path: "decoding thread".to_owned(), source })?;
        self.state = State::Running { frames, thread };
        Ok(())
    }

    /// Ends the thread; `false` if it died.
    fn close(&mut self) -> bool {
        match std::mem::replace(&mut self.state, State::Ended) {
            State::Running { frames, thread } => {
                // The sender fails once the receiver is gone, so the thread ends soon.
                drop(frames);
                let ended = thread.join();
                self.shortfall = ended.as_ref().ok().cloned().flatten();
                ended.is_ok()
            }
            State::Waiting(_) | State::Ended => true,
        }
    }
}

impl FrameSource for Prefetch {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    fn set_max_side(&mut self, side: u32) {
        self.max_side = Some(self.max_side.map_or(side, |own| own.min(side)));
    }

    /// # Errors
    /// Those of the source, and [`FrameError::Io`] when the system gives no thread.
    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        self.start()?;
        let State::Running { frames, .. } = &self.state else { return Ok(None) };
        match frames.recv() {
            Ok(Ok(frame)) => Ok(Some(frame)),
            Ok(Err(error)) => {
                self.close();
                Err(error)
            }
            Err(_) => {
                if self.close() {
                    Ok(None)
                } else {
                    Err(FrameError::Malformed {
                        path: self.info.format.clone(),
                        what: "the decoder broke down on this input".to_owned(),
                    })
                }
            }
        }
    }

    fn shortfall(&self) -> Option<String> {
        self.shortfall.clone()
    }
}

impl Drop for Prefetch {
    fn drop(&mut self) {
        self.close();
    }
}
