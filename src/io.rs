//! Frame sources, and pose sources and sinks.
