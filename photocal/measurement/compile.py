"""Kernels of measurements compiled at setup, so that no measurement waits for the compiler."""

import numpy as np

from photocal.measurement.patch_kernel import match_patches
from photocal.measurement.thinning import spaced, thin
from photocal.measurement.tracks import Tracks


def compile_kernels() -> None:
    """Match one patch with the picture it was cut from, and thin two tracks."""
    row, column = np.mgrid[:15, :15].astype(np.float32)
    picture = np.sin(row) * np.cos(0.7 * column)
    patches = np.ascontiguousarray(picture[None, 2:13, 2:13])
    matched, likeness, covariance = np.empty((1, 2)), np.empty(1), np.zeros((1, 2, 2))
    match_patches(patches, picture, np.full((1, 2), 7.0), np.eye(2)[None], 1.0, matched, likeness, covariance)
    twice = Tracks(np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1]), np.zeros((4, 2)), np.ones(4))
    thin(spaced(twice, 1.0), np.ones((2, 2)), 1, 1)
