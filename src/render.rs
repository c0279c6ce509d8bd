//! A small software renderer for meshes: previews, overlays and synthetic clips.
