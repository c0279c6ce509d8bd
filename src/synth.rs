//! Synthetic clips of the model with known poses.
