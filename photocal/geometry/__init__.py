"""Cameras, distortion, rotations and collinearity: the geometry of one ray."""
