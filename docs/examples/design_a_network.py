"""Precision of a camera from four ways to photograph a test field, before a picture is taken.

The covariance of an adjustment depends on its geometry and on the standard deviations of the observations,
not on their values: observations without errors give the precision that real ones will reach.
"""

import numpy as np

import photocal

x, y = np.meshgrid(np.linspace(-1.5, 1.5, 9), np.linspace(-1.0, 1.0, 7))
wall = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
corner = wall.copy()
corner[:, 2] = 0.4 * np.abs(corner[:, 0])
lens = photocal.camera("lens", "brown-ideal", "px", (6000, 4000), (1, 1), {"c": 6400.0, "K1": 2e-9})


def sigma_of_c(field: np.ndarray, tilt_deg: float, roll: bool) -> float:
    """Standard deviation of c, px, from eight stations 4 m away; 0.3 px, points to 0.2 mm."""
    around = np.arange(8) * np.pi / 4
    tilt = np.radians(tilt_deg) if tilt_deg else 0.0
    angles = np.column_stack(
        [tilt * np.sin(around), tilt * np.cos(around), (np.arange(8) % 4 if roll else 0 * around) * np.pi / 2]
    )
    stations = 4.0 * np.column_stack(
        [np.sin(tilt) * np.cos(around), -np.sin(tilt) * np.sin(around), np.full(8, np.cos(tilt))]
    )
    images = photocal.OrientedImages(
        tuple("abcdefgh"), (lens,), np.zeros(8, int), np.hstack([angles, stations])
    )
    pixels = np.array([images.project(np.full(len(field), k), field) for k in range(8)])
    pixels[(pixels < 0).any(axis=2) | (pixels > (5999, 3999)).any(axis=2)] = np.nan
    block = photocal.block_of_arrays(field, pixels, (6000, 4000), sigma_px=0.3, sigma_m=0.0002)
    return photocal.adjust(block).camera().sigma_of("c")


for name, field, tilt, roll in (
    ("flat field, convergent 15 degrees", wall, 15.0, False),
    ("and rolled by 90 degrees", wall, 15.0, True),
    ("flat field, convergent 35 degrees, rolled", wall, 35.0, True),
    ("two walls that meet, 35 degrees, rolled", corner, 35.0, True),
):
    print(f"{name}: sigma of c {sigma_of_c(field, tilt, roll):.2f} px")
