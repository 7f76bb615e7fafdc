"""Statistics of images and points against plain loops, and against the published ones of the DCS460."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.ray_statistics import by_image, by_point, correlations
from tests.photocal import networks

REFERENCE = Path(__file__).parents[2] / "reference" / "dcs460"


def test_against_plain_loops() -> None:
    network = networks.observe(networks.convergent(), np.random.default_rng(2), missing=0.3)
    solution = adjust(network)
    w = solution.residuals / (network.rays.sigma * np.sqrt(solution.redundancy))
    for stats, group in (
        (by_image(network, solution), network.rays.image),
        (by_point(network, solution), network.rays.point),
    ):
        for k in range(len(stats.rays)):
            mine = np.flatnonzero(group == k)
            assert stats.rays[k] == len(mine)
            assert stats.rms[k] == pytest.approx(np.sqrt((solution.residuals[mine] ** 2).mean(axis=0)))
            assert stats.redundancy[k] == pytest.approx(solution.redundancy[mine].mean())
            assert stats.largest_w[k] == pytest.approx(np.abs(w[mine]).max())
            assert stats.largest_w[k] == pytest.approx(np.abs(w[stats.worst_ray[k]]).max())


def test_image_without_rays() -> None:
    network = networks.observe(networks.convergent(), np.random.default_rng(2))
    solution = adjust(network)
    more = replace(network, image_names=(*network.image_names, "unused"))
    stats = by_image(more, solution)
    assert stats.rays[-1] == 0
    assert np.isnan(stats.rms[-1]).all()
    assert np.isnan(stats.largest_w[-1])
    assert stats.worst_ray[-1] == -1


def test_correlations() -> None:
    """The published covariance of the DCS460 gives its correlations; held values have none."""
    with (REFERENCE / "iop_covariance.csv").open(encoding="utf-8", newline="") as text:
        rows = list(csv.DictReader(text))
    names = list(dict.fromkeys(r["row"] for r in rows))
    matrix = np.zeros((9, 9))
    for r in rows:
        a, b = names.index(r["row"]), names.index(r["col"])
        matrix[a, b] = matrix[b, a] = float(r["value"])
    found = correlations(matrix)
    assert np.isnan(found[8]).all()
    assert np.diag(found)[:8] == pytest.approx(np.ones(8))
    k2, k3 = names.index("K2"), names.index("K3")
    assert found[k2, k3] == pytest.approx(matrix[k2, k3] / (matrix[k2, k2] * matrix[k3, k3]) ** 0.5)
    assert found[k2, k3] < -0.95
