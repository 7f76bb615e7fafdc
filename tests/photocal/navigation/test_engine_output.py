"""Reading the engine's positions: what is no covariance is not taken for one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from photocal.navigation.engine import read_solution

# week, seconds, lat, lon, height, quality, satellites, sdn, sde, sdu, sdne, sdeu, sdun, age, ratio
_ROW = "2371 {t}.0 -25.4 -49.2 913.8 {q} 13 {sn} {se} 0.0103 {sne} 0.0013 0.0031 0.00 18.4"


def _read(folder: Path, *rows: tuple[int, str, str, str]) -> np.ndarray:
    lines = [_ROW.format(t=50417 + k, q=q, sn=sn, se=se, sne=sne) for k, (q, sn, se, sne) in enumerate(rows)]
    (folder / "a.pos").write_text("\n".join(["% GPST", *lines]) + "\n", encoding="utf-8")
    return read_solution(folder / "a.pos").covariance_m2


@pytest.mark.parametrize(
    "broken",
    [(1, "0.0041", "0.0032", "0.0208"), (1, "0.0000", "0.0032", "0.0208"), (1, "0.0000", "0.0032", "0.0000")],
)
def test_impossible_covariances_are_those_of_the_nearest_fix(
    broken: tuple[int, str, str, str], tmp_path: Path
) -> None:
    covariance = _read(
        tmp_path,
        (1, "0.0038", "0.0032", "0.0016"),
        (1, "0.0050", "0.0032", "0.0016"),
        broken,
        (2, "0.2000", "0.3000", "0.0100"),
    )
    assert (np.linalg.eigvalsh(covariance)[:, 0] > 0).all()
    np.testing.assert_array_equal(covariance[2], covariance[1])
    assert covariance[0, 1, 1] == pytest.approx(0.0038**2)


def test_without_a_neighbour_the_sigmas_are_left(tmp_path: Path) -> None:
    covariance = _read(
        tmp_path,
        (1, "0.0041", "0.0032", "0.0208"),
        (2, "0.2000", "0.3000", "0.0100"),
        (2, "0.2", "0.3", "0.01"),
    )
    np.testing.assert_allclose(covariance[0], np.diag([0.0032**2, 0.0041**2, 0.0103**2]))
