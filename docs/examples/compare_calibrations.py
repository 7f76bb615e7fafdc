"""Whether a camera stayed the same over three flights: before the third its lens was refocused."""

import dataclasses

import numpy as np

import photocal

rng = np.random.default_rng(7)
points = rng.uniform([-60, -60, 0], [60, 60, 15], (150, 3))
places = np.array([(x, y, 100.0 + 25 * (x > 0)) for x in (-40, -15, 15, 40) for y in (-30, 0, 30)])


def calibrated(flight: str, c: float) -> photocal.Camera:
    """Calibrate by a flight over surveyed points whose camera has the principal distance c, px."""
    lens = {"c": c, "x0": 9.0, "y0": -5.0, "K1": -8e-9}
    true = photocal.camera("true", "brown-ideal", "px", (4000, 3000), (1, 1), lens)
    poses = np.column_stack([rng.normal(0, 0.08, (12, 2)), np.arange(12) * np.pi / 2, places])
    images = photocal.OrientedImages(tuple("abcdefghijkl"), (true,), np.zeros(12, int), poses)
    pixels = np.array([images.project(np.full(150, k), points) for k in range(12)])
    pixels[(pixels < 0).any(axis=2) | (pixels > (3999, 2999)).any(axis=2)] = np.nan
    block = photocal.block_of_arrays(
        points, pixels + rng.normal(0, 0.3, pixels.shape), (4000, 3000), sigma_px=0.3, sigma_m=0.005
    )
    return dataclasses.replace(photocal.adjust(block).camera(), id=flight)


cameras = [calibrated("March", 3650.0), calibrated("April", 3650.0), calibrated("May", 3657.3)]
for camera in cameras:
    print(f"{camera.id}: c {camera.value('c'):.2f} +- {camera.sigma_of('c'):.2f} px")
for pair in photocal.compare(cameras).pairs:
    spr = next(one for one in pair.figures if one.definition == "relief 100 m")
    says = "another camera" if spr.p_value < 0.01 else "the same"
    print(
        f"{pair.first} and {pair.second}: {says}; {spr.value_px:.2f} px after resection, p {spr.p_value:.3f}"
    )
