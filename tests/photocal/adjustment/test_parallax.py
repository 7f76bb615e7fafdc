"""Which points rays determine: those of heads of one exposure do not."""

from __future__ import annotations

import numpy as np

from photocal.adjustment.adjusted import determined
from tests.photocal.rigs import flight


def test_rays_of_one_exposure_determine_no_point() -> None:
    _, network = flight(np.random.default_rng(4), exposures=20, points=400)
    rays = network.rays
    # Exposures by place: heads of a frame are decimetres apart.
    _, exposure = np.unique(np.round(network.exposures.values[:, 3:5] / 2.0), axis=0, return_inverse=True)
    tie = ~network.points.held.any(axis=1) & (np.diagonal(network.points.weight, axis1=1, axis2=2) == 0).all(
        axis=1
    )
    everything = np.ones(len(rays.point), dtype=np.bool_)
    assert determined(network, everything)[np.bincount(rays.point, minlength=len(tie)) >= 2].all()
    # Of each point the rays of the exposure of its first ray stay: one head, or two that overlap.
    first = np.full(len(tie), -1)
    for ray in range(len(rays.point) - 1, -1, -1):
        first[rays.point[ray]] = exposure[rays.image[ray]]
    kept = exposure[rays.image] == first[rays.point]
    loses = np.bincount(rays.point[~kept], minlength=len(tie)) > 0
    assert (loses & tie).sum() > 100
    assert not determined(network, kept)[loses & tie].any()
    # Without one ray in three most points still have rays from far apart.
    rest = np.arange(len(rays.point)) % 3 > 0
    count = np.bincount(rays.point[rest], minlength=len(tie))
    assert determined(network, rest)[tie & (count >= 6)].mean() > 0.9
