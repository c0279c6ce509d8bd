//! Tuning constants as options that know themselves: name, unit, default and where the default comes from.
//!
//! Each stage declares its constants once with [`tuning!`]; code reads fields, `spec/tuning.md` is written from
//! [`Tuning::visit`], and `handcast bench tuning` halves and doubles them one by one through [`Number::scale`].

/// A number, or several, that can be tuned.
pub trait Number {
    /// The numbers.
    fn values(&self) -> Vec<f64>;

    /// Multiplies all of them by `factor`; whole numbers are rounded, and stay at least 1 where they were.
    fn scale(&mut self, factor: f64);
}

macro_rules! real {
    ($($t:ty)*) => { $(impl Number for $t {
        fn values(&self) -> Vec<f64> {
            vec![f64::from(*self)]
        }

        fn scale(&mut self, factor: f64) {
            *self = (f64::from(*self) * factor) as $t;
        }
    })* };
}

macro_rules! whole {
    ($($t:ty)*) => { $(impl Number for $t {
        fn values(&self) -> Vec<f64> {
            vec![*self as f64]
        }

        fn scale(&mut self, factor: f64) {
            let least = if *self > 0 { 1.0 } else { 0.0 };
            *self = (*self as f64 * factor).round().max(least) as $t;
        }
    })* };
}

real!(f64 f32);
whole!(u8 u16 u32 u64 usize);

impl<T: Number, const N: usize> Number for [T; N] {
    fn values(&self) -> Vec<f64> {
        self.iter().flat_map(Number::values).collect()
    }

    fn scale(&mut self, factor: f64) {
        self.iter_mut().for_each(|v| v.scale(factor));
    }
}

/// One tuning constant, as [`Tuning::visit`] shows it.
pub struct Constant<'a> {
    /// Where it stands in the tree of options: `registration.sizes.learning_rate`.
    pub path: String,
    /// What it is, in a sentence.
    pub meaning: &'static str,
    /// Unit, `1` where it has none.
    pub unit: &'static str,
    /// Where the default comes from: the paper's section, or the command that measured it.
    pub source: &'static str,
    /// The value.
    pub value: &'a mut dyn Number,
}

/// A group of tuning constants.
pub trait Tuning: Default {
    /// Shows every constant of the group, those of groups inside it too; `path` comes before their names.
    fn visit(&mut self, path: &str, visitor: &mut dyn FnMut(Constant<'_>));
}

/// Declares a group of tuning constants: a struct of public fields with [`Default`] and [`Tuning`]. Fields with a
/// value are constants, with unit and source; fields without one are groups.
///
/// ```
/// use handcast_vision::tuning::{Tuning, tuning};
///
/// tuning! {
///     /// How colours are compared.
///     pub struct Colours {
///         /// Largest distance of one tint.
///         ["1", "handcast bench track --silhouettes picture"]
///         pub same_tint: f32 = 0.045,
///         /// Side of a cell.
///         ["pixels", "handcast bench track --scaling"]
///         pub cell: usize = 8,
///     }
/// }
/// tuning! {
///     /// Segmentation.
///     pub struct Segmentation {
///         /// Colours.
///         pub colours: Colours,
///     }
/// }
/// let mut names = Vec::new();
/// Segmentation::default().visit("segment", &mut |c| names.push(c.path));
/// assert_eq!(names, ["segment.colours.same_tint", "segment.colours.cell"]);
/// ```
#[macro_export]
macro_rules! tuning {
    (
        $(#[doc = $about:literal])*
        $vis:vis struct $name:ident {
            $(
                $(#[doc = $doc:literal])+
                $([$unit:literal, $source:literal])?
                pub $field:ident: $type:ty $(= $value:expr)?
            ),+ $(,)?
        }
    ) => {
        $(#[doc = $about])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[non_exhaustive]
        $vis struct $name {
            $($(#[doc = $doc])+ pub $field: $type,)+
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $crate::tuning!(@default $($value)?),)+ }
            }
        }

        impl $crate::tuning::Tuning for $name {
            fn visit(&mut self, path: &str, visitor: &mut dyn FnMut($crate::tuning::Constant<'_>)) {
                $(
                    let name = format!("{path}.{}", stringify!($field));
                    $crate::tuning!(@visit self.$field, name, visitor, concat!($($doc),+), $($unit, $source)?);
                )+
            }
        }
    };
    (@default $value:expr) => { $value };
    (@default) => { Default::default() };
    (@visit $field:expr, $name:ident, $visitor:ident, $meaning:expr, $unit:literal, $source:literal) => {
        $visitor($crate::tuning::Constant {
            path: $name,
            meaning: $meaning.trim(),
            unit: $unit,
            source: $source,
            value: &mut $field,
        });
    };
    (@visit $field:expr, $name:ident, $visitor:ident, $meaning:expr,) => {
        $crate::tuning::Tuning::visit(&mut $field, &$name, $visitor);
    };
}

pub use tuning;

#[cfg(test)]
mod tests {
    use super::*;

    tuning! {
        struct Inner {
            /// Three weights,
            /// one a channel.
            ["1", "made up"]
            pub weights: [f64; 3] = [1.0, 2.0, 3.0],
            /// Rounds.
            ["rounds", "made up"]
            pub rounds: usize = 1,
        }
    }

    tuning! {
        struct Outer {
            /// The inner group.
            pub inner: Inner,
            /// A length.
            ["m", "made up"]
            pub length: f64 = 0.5,
        }
    }

    #[test]
    fn constants_are_shown_with_their_values_and_can_be_scaled() {
        let mut outer = Outer::default();
        let mut seen = Vec::new();
        outer.visit("outer", &mut |c| {
            seen.push((c.path, c.meaning, c.unit, c.value.values()));
            c.value.scale(0.5);
        });
        assert_eq!(seen.len(), 3);
        assert_eq!(seen[0].0, "outer.inner.weights");
        assert_eq!(seen[0].1, "Three weights, one a channel.");
        assert_eq!((seen[2].0.as_str(), seen[2].2, &seen[2].3[..]), ("outer.length", "m", &[0.5][..]));
        assert_eq!((outer.inner.weights, outer.inner.rounds, outer.length), ([0.5, 1.0, 1.5], 1, 0.25));
    }
}
