"""The shape of a network against closed figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.report.derived_figures import network_shape
from photocal.report.stored_analysis import AnalysedRun

Floats = NDArray[np.float64]


def moved(run: AnalysedRun, angles_deg: Floats, station: Floats) -> AnalysedRun:
    images = replace(run.result.images, values=np.hstack([np.radians(angles_deg), station]))
    return replace(run, result=replace(run.result, images=images))


@pytest.mark.shared
def test_convergence_of_the_published_wall(published_run: AnalysedRun) -> None:
    """Stations left, middle and right of the wall, phi from -30 to 37 degrees by the published table."""
    shape = network_shape(published_run, "dcs460")
    assert shape is not None
    assert 60.0 < shape[0] < 80.0


def test_two_axes_a_right_angle_apart(invented_run: AnalysedRun) -> None:
    """Turned by 90 degrees about Y in two images, not at all in the others."""
    n = len(invented_run.result.images)
    angles = np.zeros((n, 3))
    angles[:2, 1] = 90.0
    shape = network_shape(moved(invented_run, angles, invented_run.result.images.station), "l1")
    assert shape is not None
    assert shape[0] == pytest.approx(90.0)


def test_depths_of_a_plane_seen_from_above(invented_run: AnalysedRun) -> None:
    n = len(invented_run.result.images)
    position = np.column_stack([np.arange(n) * 30.0, np.zeros(n), np.full(n, 100.0)])
    run = moved(invented_run, np.zeros((n, 3)), position)
    points = replace(run.result.points, values=run.result.points.values * [1.0, 1.0, 0.0])
    shape = network_shape(replace(run, result=replace(run.result, points=points)), "l1")
    assert shape is not None
    assert shape[1] == pytest.approx(0.0, abs=1e-9)
    # The angle of an arccosine near 1: half of the digits are lost.
    assert shape[0] == pytest.approx(0.0, abs=1e-5)
