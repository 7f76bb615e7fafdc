"""Site calibration against closed forms and by what a moved point does."""

import numpy as np
import pytest

from photocal.base.errors import IllPosedError
from photocal.geometry.localisation import CommonPoints, localise, similarity

MAP = np.array([
    [677_000.0, 7_184_000.0, 900.0], [677_800.0, 7_184_100.0, 912.0], [677_700.0, 7_184_900.0, 940.0],
    [676_900.0, 7_184_800.0, 925.0], [677_350.0, 7_184_450.0, 918.0], [677_100.0, 7_184_500.0, 905.0],
])  # fmt: skip
NAMES = tuple("ABCDEF")


def local_of(places: np.ndarray, angle: float = 0.3, scale: float = 1.0004) -> np.ndarray:
    """A site system: turned, scaled, shifted; its heights above a plane of 20 and -10 ppm."""
    offset = places[:, :2] - [677_000.0, 7_184_000.0]
    c, s = np.cos(angle), np.sin(angle)
    plan = scale * offset @ np.array([[c, -s], [s, c]]).T + [1000.0, 5000.0]
    return np.column_stack([plan, places[:, 2] - 850.0 + offset @ [20e-6, -10e-6]])


def noisy(seed: int, sigma: float = 0.01) -> CommonPoints:
    """Common points with noise in the local coordinates."""
    rng = np.random.default_rng(seed)
    local = local_of(MAP) + rng.normal(0.0, sigma, MAP.shape)
    return CommonPoints(NAMES, MAP, local, np.full(MAP.shape, sigma))


def test_what_was_put_in_comes_out() -> None:
    found = localise(CommonPoints(NAMES, MAP, local_of(MAP)))
    assert found.plan.parameters[2:] == pytest.approx([0.3, 1.0004], abs=1e-10)
    assert found.height.parameters[1:] == pytest.approx([20e-6, -10e-6], abs=1e-12)
    others = MAP + np.array([300.0, -200.0, 15.0])
    assert np.abs(found.to_local(others) - local_of(others)).max() < 1e-6
    assert np.abs(found.to_map(local_of(others)) - others).max() < 1e-6


def test_the_plan_is_umeyamas_similarity() -> None:
    """With equal weights the closed form of Umeyama (1991) in the plane is the same estimate."""
    points = noisy(1)
    flat = points.map_m * [1, 1, 0], points.local_m * [1, 1, 0]
    closed = similarity(*flat)
    assert closed is not None
    assert localise(points).to_local(MAP)[:, :2] == pytest.approx(closed.applied(flat[0])[:, :2], abs=1e-6)


def test_a_held_scale_stays() -> None:
    found = localise(noisy(2), 1.0)
    assert found.plan.parameters[3] == 1.0
    assert found.plan.covariance[3, 3] == 0.0
    # 400 ppm over 500 m are seen in the residuals.
    assert np.abs(found.plan.residual_m).max() > 0.1


def test_miss_is_the_difference_to_a_fit_without_the_point() -> None:
    points = noisy(3)
    whole = localise(points)
    keep = np.arange(len(MAP)) != 4
    without = localise(
        CommonPoints(NAMES[:4] + NAMES[5:], MAP[keep], points.local_m[keep], np.full((5, 3), 0.01))
    )
    expected = without.to_local(MAP[4:5])[0] - points.local_m[4]
    assert np.append(whole.plan.miss_m[4], whole.height.miss_m[4]) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("known", [True, False])
def test_a_moved_point_is_named_and_no_other(known: bool) -> None:
    points = noisy(5)
    local = points.local_m.copy()
    local[2, 0] += 0.15
    local[3, 2] -= 0.15
    found = localise(CommonPoints(NAMES, MAP, local, points.sigma_m if known else None))
    assert NAMES[int(np.nanargmin(found.plan.probability))] == "C"
    assert NAMES[int(np.nanargmin(found.height.probability))] == "D"
    assert found.plan.doubtful.keys() == {2}
    if known:
        assert found.height.doubtful.keys() == {3}


def test_clean_points_alarm_as_often_as_was_said() -> None:
    """The family of tests alarms in 0.5 % of cases: of 400 at most 7 by chance (99 %)."""
    alarms = sum(bool(localise(noisy(seed)).plan.doubtful) for seed in range(400))
    assert alarms <= 7


def test_sigmas_of_the_parameters_are_their_spread() -> None:
    fits = [localise(noisy(seed)) for seed in range(300)]
    spread = np.std([fit.plan.parameters for fit in fits], axis=0)
    assert spread == pytest.approx(np.sqrt(np.diag(fits[0].plan.covariance)), rel=0.15)
    slopes = np.std([fit.height.parameters for fit in fits], axis=0)
    assert slopes == pytest.approx(np.sqrt(np.diag(fits[0].height.covariance)), rel=0.15)
    place = MAP[:1] + np.array([2000.0, 0.0, 0.0])
    moved = np.std([fit.to_local(place)[0] for fit in fits], axis=0)
    assert moved == pytest.approx(fits[0].sigma_m(place)[0], rel=0.15)


def test_few_points_fit_what_they_can() -> None:
    two = localise(CommonPoints(("A", "B"), MAP[:2], local_of(MAP[:2])))
    assert not two.tilted
    assert two.plan.redundancy == 0
    assert np.isnan(two.plan.probability).all()
    # Nobody stated sigmas and nothing is left over in plan: how sure it is, is not known.
    assert np.isnan(two.sigma_m(MAP)[:, :2]).all()
    assert two.height.redundancy == 1
    with pytest.raises(IllPosedError, match="1 common points"):
        localise(CommonPoints(("A",), MAP[:1], local_of(MAP[:1])))
