#![doc = include_str!("../README.md")]

mod corpus;
mod inputs;
mod ledger;
mod line;
mod page;
mod report;
mod settings;
mod work;

pub use corpus::{Choice, Corpus, CorpusError};
pub use inputs::{CLIP_ENDINGS, Item, RUN_RESULTS};
pub use line::{Entry, Failure, Kind, Outcome};
pub use report::{Report, Run};
pub use settings::{Aim, EncodeSettings, Settings, TrackSettings};
pub use work::{Places, Worker};

/// What makes the streams, with its version: part of each line, as another version may make other streams.
pub const MADE_BY: &str = concat!("handcast ", env!("CARGO_PKG_VERSION"));
