//! BAPs: the table of the standard, frames of values, text formats, and the mapping to hand poses.
