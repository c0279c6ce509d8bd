//! Round-trip error measures, bit-rate accounts and the report.
