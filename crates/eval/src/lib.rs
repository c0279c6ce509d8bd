//! Evaluation of handcast: synthetic clips with their truth, the registration methods of the paper, and the fidelity
//! of the round trip.

pub mod fidelity;
pub mod methods;
pub mod sensitivity;

pub mod synth;
