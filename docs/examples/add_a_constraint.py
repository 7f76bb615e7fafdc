"""A network without control, and what a scale bar does to it: observations of one's own between points."""

import numpy as np

import photocal

rng = np.random.default_rng(2)
points = rng.uniform([-2, -2, 0], [2, 2, 1], (40, 3))
lens = photocal.camera("lens", "brown-ideal", "px", (4000, 3000), (1, 1), {"c": 3600.0})
angles = np.column_stack([rng.uniform(-0.5, 0.5, (6, 2)), np.arange(6) * np.pi / 3])
stations = np.column_stack([6 * np.sin(angles[:, 1]), -6 * np.sin(angles[:, 0]), np.full(6, 7.0)])
images = photocal.OrientedImages(tuple("abcdef"), (lens,), np.zeros(6, int), np.hstack([angles, stations]))
pixels = np.array([images.project(np.full(40, k), points) for k in range(6)]) + rng.normal(0, 0.3, (6, 40, 2))

# Start coordinates that are one per cent too large: without control nothing contradicts them.
free = photocal.block_of_arrays(1.01 * points, pixels, (4000, 3000), sigma_px=0.3, sigma_m=None, lens=lens)
length = float(np.linalg.norm(points[0] - points[1]))
barred = photocal.with_relations(free, "distance", [("1", "2", length, 1e-5)])

for name, block in (("free", free), ("with a scale bar", barred)):
    xyz = photocal.adjust(block).points.values
    scale = np.linalg.norm(xyz[2] - xyz[3]) / np.linalg.norm(points[2] - points[3])
    print(f"{name}: another distance is {100 * (scale - 1):+.3f} % off")
