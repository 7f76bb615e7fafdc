"""Calibrate a camera from two arrays: object coordinates (m) and image coordinates (px)."""

import numpy as np

import photocal

# Arrays as from a calibration field; here 60 points and 8 images are simulated, with noise of 0.3 px.
rng = np.random.default_rng(1)
points = rng.uniform([-2, -2, 0], [2, 2, 1], (60, 3))
true = photocal.camera(
    "true", "brown-ideal", "px", (4000, 3000), (1, 1), {"c": 3650.0, "x0": 12.0, "K1": 4e-9}
)
angles = np.column_stack([rng.uniform(-0.5, 0.5, (8, 2)), np.arange(8) * np.pi / 4])
stations = np.column_stack([6 * np.sin(angles[:, 1]), -6 * np.sin(angles[:, 0]), np.full(8, 7.0)])
images = photocal.OrientedImages(tuple("abcdefgh"), (true,), np.zeros(8, int), np.hstack([angles, stations]))
pixels = np.array([images.project(np.full(60, k), points) for k in range(8)]) + rng.normal(0, 0.3, (8, 60, 2))

surveyed = points + rng.normal(0, 0.0005, points.shape)

# The calibration.
block = photocal.block_of_arrays(surveyed, pixels, (4000, 3000), sigma_px=0.3, sigma_m=0.0005)
result = photocal.adjust(block)
print(result)
camera = result.cameras["camera"]
print("c is", camera.value("c"), "+-", camera.sigma_of("c"), "px; the truth is", true.value("c"))
print("correlation of c and x0:", camera.correlation_of(["c", "x0"])[0, 1])
print(result.tables()["residuals"].slice(0, 2).to_pylist())
