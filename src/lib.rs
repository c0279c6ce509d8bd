//! MPEG-4 hand animation: video of a hand to a BAP stream, and back to an animated glTF hand.
