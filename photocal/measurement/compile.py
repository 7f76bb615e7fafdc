"""Compile the kernel of the matching once, at setup, so that the first measurement does not wait for it."""

from __future__ import annotations

import numpy as np

from photocal.measurement.patch_kernel import match_patches


def compile_kernels() -> None:
    """Match one patch with the picture it was cut from."""
    row, column = np.mgrid[:15, :15].astype(np.float32)
    picture = np.sin(row) * np.cos(0.7 * column)
    patches = np.ascontiguousarray(picture[None, 2:13, 2:13])
    found, likeness, covariance = np.empty((1, 2)), np.empty(1), np.zeros((1, 2, 2))
    match_patches(patches, picture, np.full((1, 2), 7.0), np.eye(2)[None], 1.0, found, likeness, covariance)
