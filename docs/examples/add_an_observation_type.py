"""A free network, and the effect of additional observations: a scale bar, and a type of your own."""

import numpy as np

import photocal

rng = np.random.default_rng(2)
points = rng.uniform([-2, -2, 0], [2, 2, 1], (40, 3))
lens = photocal.camera("lens", "brown-ideal", "px", (4000, 3000), (1, 1), {"c": 3600.0})
angles = np.column_stack([rng.uniform(-0.5, 0.5, (6, 2)), np.arange(6) * np.pi / 3])
stations = np.column_stack([6 * np.sin(angles[:, 1]), -6 * np.sin(angles[:, 0]), np.full(6, 7.0)])
images = photocal.OrientedImages(tuple("abcdef"), (lens,), np.zeros(6, int), np.hstack([angles, stations]))
pixels = np.array([images.project(np.full(40, k), points) for k in range(6)]) + rng.normal(0, 0.3, (6, 40, 2))


def level_distance(difference):
    """Distance in the horizontal plane, as a total station reduces it, and its derivatives."""
    length = np.hypot(difference[:, 0], difference[:, 1])
    return length, np.column_stack([difference[:, :2] / length[:, None], np.zeros(len(length))])


# Start coordinates that are one per cent too large: without control nothing contradicts them.
free = photocal.block_of_arrays(1.01 * points, pixels, lens, sigma_px=0.3, sigma_m=None)
slope, level = np.linalg.norm(points[0] - points[1]), np.linalg.norm((points[0] - points[1])[:2])
barred = photocal.with_relations(free, "distance", [("1", "2", slope, 1e-5)])
own = photocal.with_relations(free, "level distance", [("1", "2", level, 1e-5)], level_distance)

for name, block in (("free", free), ("with a scale bar", barred), ("with a level distance", own)):
    xyz = photocal.adjust(block).points.values
    scale = np.linalg.norm(xyz[2] - xyz[3]) / np.linalg.norm(points[2] - points[3])
    print(f"{name}: another distance is {100 * (scale - 1):+.3f} % off")
