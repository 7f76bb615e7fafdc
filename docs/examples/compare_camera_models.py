"""Two camera models of one block, judged by check points kept out of the adjustment."""

import numpy as np

import photocal

rng = np.random.default_rng(3)
points = rng.uniform([-60, -60, 0], [60, 60, 15], (120, 3))
parameters = {"c": 3650.0, "x0": 9.0, "K1": -8e-9, "K2": 4e-16}
true = photocal.camera("true", "brown-ideal", "px", (4000, 3000), (1, 1), parameters)
places = np.array([(x, y, 100.0 + 20 * (x > 0)) for x in (-40, -15, 15, 40) for y in (-30, 0, 30)])
poses = np.column_stack([rng.normal(0, 0.08, (12, 2)), np.arange(12) * np.pi / 2, places])
images = photocal.OrientedImages(tuple("abcdefghijkl"), (true,), np.zeros(12, int), poses)
pixels = np.array([images.project(np.full(120, k), points) for k in range(12)])
pixels[(pixels < 0).any(axis=2) | (pixels > (3999, 2999)).any(axis=2)] = np.nan
pixels += rng.normal(0, 0.5, pixels.shape)

check = [str(k) for k in range(61, 121)]
for name, terms in (("c, x0, y0", ("c", "x0", "y0")), ("and K1, K2", ("c", "x0", "y0", "K1", "K2"))):
    lens = photocal.camera("lens", "brown-ideal", "px", (4000, 3000), (1, 1), {"c": 3600.0}, estimate=terms)
    block = photocal.block_of_arrays(points, pixels, lens, sigma_px=0.5, sigma_m=0.01, check=check)
    result = photocal.adjust(block)
    rmse = ", ".join(f"{axis} {1e3 * value:.0f}" for axis, value in result.checks.rmse_m.items())
    print(f"{name}: v'Pv / r {result.sigma0_squared:.2f}, check points {rmse} mm")
