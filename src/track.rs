//! Projection, rasterisation, objectives, optimisers, open-hand fit and the frame-to-frame tracker.
