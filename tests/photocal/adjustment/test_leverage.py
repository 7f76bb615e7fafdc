"""Images left out in closed form, against taking them out of the normal equations."""

from __future__ import annotations

import numpy as np
import pytest

from photocal.adjustment.adjusted import AdjustedNetwork, fit
from photocal.adjustment.leverage import cameras_without
from photocal.adjustment.near import Removals
from photocal.adjustment.removed import groups_of, standard_error, state_without
from photocal.base.arrays import Floats
from tests.photocal.analysis.aerial import Flight, fly


def removed(fitted: AdjustedNetwork) -> Floats:
    removals = Removals(fitted.factored)
    return np.array([state_without(removals, out).cameras for out in groups_of(fitted)])


@pytest.mark.parametrize("images", [24, 45])
def test_what_leaving_out_does_is_read_from_the_factor(images: int) -> None:
    fitted = fit(fly(Flight(images, 60 * images), images).network)
    values, possible = cameras_without(fitted, groups_of(fitted))
    exact = removed(fitted)
    assert possible.all()
    free = np.flatnonzero(fitted.network.cameras[0].estimated)
    sigma = np.sqrt(np.diag(fitted.solution.camera_covariance[0]))[free]
    change, true = ((one - fitted.state.cameras)[:, 0, free] / sigma for one in (values, exact))
    assert np.corrcoef(change.ravel(), true.ravel())[0, 1] > 0.98
    ratio = standard_error(values)[0, free] / standard_error(exact)[0, free]
    # Fifteen groups tell a spread to a fifth.
    assert (np.abs(ratio - 1.0) < 1.0 / np.sqrt(2.0 * 14.0) + 0.01).all()
    assert abs(np.median(ratio) - 1.0) < 0.1


def test_without_what_nothing_is_left_of() -> None:
    fitted = fit(fly(Flight(24, 1500), 1).network)
    everything = np.ones(24, dtype=np.bool_)
    values, possible = cameras_without(fitted, [everything, ~everything])
    assert not possible[0]
    assert (values[0] == fitted.state.cameras).all()
