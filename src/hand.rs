//! The articulated hand: skeleton, pose, constraints, morphology, shapes.
