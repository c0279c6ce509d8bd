//! The FBA object bitstream: syntax, arithmetic coder, encoder, decoder, rate control.
