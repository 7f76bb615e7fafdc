"""Mean codes contradict each other by as much as their errors last: held against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.navigation.satellite_residuals import code_errors
from tests.photocal.navigation.test_satellite_residuals import SKY, satellite_residuals

EPOCHS = 2400


def code_sigma_m() -> NDArray[np.float64]:
    """Of the difference of two receivers, RTKLIB's weights of codes (manual 2.4.2, E.24)."""
    up = np.sin(np.radians([float(elevation) for _, _, elevation in SKY]))
    return np.asarray(0.3 * np.sqrt(2.0 * (1.0 + 1.0 / up**2)))


def factors(errors: NDArray[np.float64]) -> dict[int, float]:
    """Factors by length for errors (epochs, satellites) in units of the engine's sigmas."""
    seen = satellite_residuals(len(errors), np.zeros(errors.shape))
    found = code_errors(replace(seen, code_m=(errors * code_sigma_m()).ravel()))
    assert found is not None
    return dict(zip(found.epochs.astype(int).tolist(), found.factor.tolist(), strict=True))


def test_white_noise_of_the_engines_weights_needs_no_factor() -> None:
    found = factors(np.random.default_rng(1).standard_normal((EPOCHS, len(SKY))))
    assert found[1] == pytest.approx(1.0, abs=0.1)
    assert found[32] == pytest.approx(1.0, abs=0.2)


def test_what_never_changes_does_not_average() -> None:
    constant = np.random.default_rng(2).standard_normal(len(SKY))
    found = factors(np.tile(constant, (EPOCHS, 1)))
    assert found[EPOCHS] / found[1] == pytest.approx(EPOCHS, rel=1e-6)


@pytest.mark.parametrize("lasts", [8.0, 60.0])
def test_multipath_averages_as_its_correlation_lets_it(lasts: float) -> None:
    """Variance of the mean of a Gauss-Markov process over n steps (Priestley 1981, 5.3.5)."""
    rng, ratio = np.random.default_rng(3), []
    for _ in range(12):
        steps = rng.standard_normal((EPOCHS, len(SKY)))
        keep = np.exp(-1.0 / lasts)
        multipath = np.empty_like(steps)
        multipath[0] = steps[0]
        for k in range(1, EPOCHS):
            multipath[k] = keep * multipath[k - 1] + np.sqrt(1 - keep**2) * steps[k]
        ratio.append([factors(multipath)[length] for length in (16, 256)])
    for length, seen in zip((16, 256), np.mean(ratio, axis=0), strict=True):
        lag = np.arange(1, length)
        expected = 1 + 2 * np.sum((1 - lag / length) * keep**lag)
        assert seen == pytest.approx(expected, rel=0.15)


def test_a_position_shows_in_no_residual_and_few_satellites_tell_nothing() -> None:
    """An error of the position itself is not taken for one of the codes."""
    azimuth, elevation = np.radians([[a, e] for _, a, e in SKY]).T
    level = np.cos(elevation)
    towards = np.column_stack([np.sin(azimuth) * level, np.cos(azimuth) * level, np.sin(elevation)])
    seen = satellite_residuals(64, np.zeros((64, len(SKY))))
    found = code_errors(replace(seen, code_m=np.tile(-towards @ [3.0, -2.0, 5.0], 64)))
    assert found is not None
    assert found.factor[0] < 1e-3
    clocks = [[name == "G", name == "E"] for name, _, _ in SKY]
    design = np.column_stack([towards, clocks])
    normal = (design / code_sigma_m()[:, None] ** 2).T @ design
    assert found.one_m == pytest.approx(np.sqrt(np.diag(np.linalg.inv(normal))[:3]), rel=1e-9)
    # Four satellites of one system give a position and its clock, and nothing to hold against it.
    few = satellite_residuals(64, np.zeros((64, len(SKY))))
    lost = np.isin(few.satellite, few.satellite[:4])
    columns = {name: getattr(few, name)[lost] for name in ("satellite", "frequency", "azimuth", "elevation")}
    columns |= {"residual_m": few.residual_m[lost], "code_m": few.code_m[lost], "time": few.time[lost]}
    assert code_errors(replace(few, **columns)) is None
