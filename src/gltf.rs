//! glTF export of poses with mesh and skin.
