"""Areas and volumes of closed outlines: ellipses, squares, cones, spheres, scatter of noisy points."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ellipe
from typer.testing import CliRunner

from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError
from photocal.commands.cli import app
from photocal.products.sections import RingPoints
from photocal.products.volume import measure_closed, outline_form


def rings(xy: Floats, heights: Floats, sigma: float = 0.01) -> RingPoints:
    """Outlines (m, n, 2) one above the other."""
    m, n = xy.shape[:2]
    values = np.concatenate([xy.reshape(-1, 2), np.repeat(heights, n)[:, None]], axis=1)
    names = tuple(str(k) for k in np.repeat(np.arange(m), n))
    numbers = tuple(str(k) for k in range(m * n))
    return RingPoints(names, numbers, values, np.tile(np.eye(3) * sigma**2, (m * n, 1, 1)), ("X", "Y", "Z"))


def ellipse(n: int, a: float, b: float) -> Floats:
    turn = 2 * np.pi * (np.arange(n) + 0.3 * np.sin(np.arange(n))) / n
    return np.column_stack([a * np.cos(turn), b * np.sin(turn)])


def test_areas_of_known_outlines() -> None:
    oval = ellipse(40, 6.5, 4.0)
    assert oval[:, 0] @ outline_form(oval, "curve") @ oval[:, 1] == pytest.approx(np.pi * 26, rel=1e-4)
    square = np.array([[0.0, 0], [3, 0], [3, 3], [0, 3]])
    assert square[:, 0] @ outline_form(square, "polygon") @ square[:, 1] == pytest.approx(9.0)
    # A kidney, r = 3 + cos 2t + sin 3t / 2: half the integral of r^2 is pi (9 + 1 / 2 + 1 / 8).
    t = 2 * np.pi * np.arange(72) / 72
    r = 3 + np.cos(2 * t) + 0.5 * np.sin(3 * t)
    kidney = np.column_stack([r * np.cos(t), r * np.sin(t)])
    assert kidney[:, 0] @ outline_form(kidney, "curve") @ kidney[:, 1] == pytest.approx(
        np.pi * 9.625, rel=1e-4
    )


@pytest.mark.parametrize("count", [3, 4, 7])
def test_a_cone_is_exact_from_three_sections_on(count: int) -> None:
    """A frustum of an elliptic cone, h (A1 + A2 + sqrt(A1 A2)) / 3; end areas would be too large."""
    heights = np.linspace(0.0, 9.5, count)
    scale = 1.0 - heights / 19.0
    figures = measure_closed(rings(scale[:, None, None] * ellipse(60, 6.5, 4.0), heights), "curve")
    full = np.pi * 26.0
    true = 9.5 / 3 * full * (1 + 0.25 + 0.5)
    assert figures["between_sections"]["volume_m3"] == pytest.approx(true, rel=1e-4)


def test_the_middle_of_a_sphere() -> None:
    heights = np.linspace(-3.0, 3.0, 7)
    radius = np.sqrt(25.0 - heights**2)
    figures = measure_closed(rings(radius[:, None, None] * ellipse(60, 1.0, 1.0), heights), "curve")
    assert figures["between_sections"]["volume_m3"] == pytest.approx(np.pi * (25 * 6 - 18), rel=1e-4)


@pytest.mark.parametrize("shape", ["curve", "polygon"])
def test_standard_deviations_against_the_scatter(shape: str) -> None:
    rng, heights = np.random.default_rng(4), np.array([0.0, 2.5, 4.5, 7.0])
    clean = np.tile(ellipse(24, 6.5, 4.0), (4, 1, 1))
    found = []
    for _ in range(400):
        own = rings(clean, heights)
        noisy = RingPoints(
            own.section,
            own.point,
            own.values + rng.normal(0, 0.01, own.values.shape),
            own.covariance,
            own.axes,
        )
        found.append(measure_closed(noisy, shape))  # type: ignore[arg-type]
    volumes = [one["between_sections"]["volume_m3"] for one in found]
    assert np.std(volumes) == pytest.approx(found[0]["between_sections"]["sigma_m3"], rel=0.12)
    areas = [one["sections"][1]["area_m2"] for one in found]
    assert np.std(areas) == pytest.approx(found[0]["sections"][1]["area_sigma_m2"], rel=0.12)
    # Points shifted along their normals by sigma over their share of the circumference, with equal spacing.
    about = 4 * 6.5 * ellipe(1 - (4.0 / 6.5) ** 2)
    assert found[0]["sections"][1]["area_sigma_m2"] == pytest.approx(0.01 * about / np.sqrt(24), rel=0.15)


def test_the_command(tmp_path: Path) -> None:
    table = tmp_path / "sections.csv"
    rows = ["section,point,X,Y,Z"]
    rows += [
        f"{k},{j},{x},{y},{z}"
        for k, z in enumerate((0, 2))
        for j, (x, y) in enumerate([(0, 0), (3, 0), (3, 4), (0, 4)])
    ]
    table.write_text("\n".join(rows) + "\n", encoding="utf-8")
    done = CliRunner().invoke(app, ["volume", str(table), "--sigma", "0.01", "--shape", "polygon", "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["between_sections"]["volume_m3"] == pytest.approx(24.0)
    # dA by each corner is half the diagonal that it sees, 5 m: sigma 0.01 * 5 / 2 * 2.
    assert found["sections"][0]["area_sigma_m2"] == pytest.approx(0.05)
    assert (
        "by quadrature"
        in CliRunner().invoke(app, ["volume", str(table), "--sigma", "0.01", "--shape", "curve"]).stdout
    )
    assert (
        CliRunner().invoke(app, ["volume", str(table), "--sigma", "0.01", "--shape", "square"]).exit_code != 0
    )


def test_what_encloses_nothing() -> None:
    with pytest.raises(IllPosedError, match="not make an outline"):
        measure_closed(rings(ellipse(3, 1, 1)[None], np.array([0.0])), "curve")
    with pytest.raises(IllPosedError, match="different mean heights"):
        measure_closed(rings(np.tile(ellipse(8, 1, 1), (2, 1, 1)), np.zeros(2)), "curve")
