"""Volumes: the published tank, closed forms, and the variance against simulation."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from photocal.base.errors import ConfigurationError
from photocal.commands.cli import app
from photocal.products.sections import (
    cylinder_volume,
    measure_tank,
    read_ring_points,
    volume_between_sections,
)
from tests.photocal.products.conftest import TANK_HEIGHT, TANK_VARIANCE, rows_of

PUBLISHED = ["volume", "--radius", "6.479", "--radius-sigma", "0.003", "--height", "9.5", "--height-sigma"]


def test_published_volume_of_the_tank() -> None:
    told = CliRunner().invoke(app, [*PUBLISHED, "0.004", "--json"])
    figures = json.loads(told.stdout)["by_mean_radius"]
    assert figures["volume_m3"] == pytest.approx(1252.8222, abs=5e-4)
    assert figures["variance_m6"] == pytest.approx(1.62432, abs=5e-5)
    assert figures["radius_variance_m6"] == pytest.approx(1.3461, abs=5e-5)
    assert figures["height_variance_m6"] == pytest.approx(0.2783, abs=5e-5)
    assert figures["sigma_m3"] == pytest.approx(1.27449, abs=5e-5)
    assert figures["sigma_percent"] == pytest.approx(0.10173, abs=5e-6)
    said = CliRunner().invoke(app, [*PUBLISHED, "0.004"]).output
    for figure in ("1252.822 m3", "1.6243 m6", "1.2745 m3", "0.1017 %"):
        assert figure in said


def test_published_rings_of_the_tank(tank_table: str, tmp_path: Path) -> None:
    path = tmp_path / "sections.csv"
    path.write_text(tank_table, encoding="utf-8")
    tank = measure_tank(read_ring_points(path, "Z", np.sqrt(TANK_VARIANCE)))
    printed = rows_of("tank_circles.csv")
    # Recomputed from the printed residuals; printed: 0.201, 0.756, 1.366, 2.068, 2.498.
    factors = [0.206, 0.758, 1.359, 2.049, 2.522]
    for ring, row, factor in zip(tank.sections, printed, factors, strict=True):
        circle = ring.circle
        assert circle.center == pytest.approx([float(row["xc_m"]), float(row["yc_m"])], abs=3e-4)
        assert circle.radius == pytest.approx(float(row["radius_m"]), abs=7e-4)
        assert np.pi * circle.radius**2 == pytest.approx(float(row["area_m2"]), abs=0.01)
        assert len(ring.points) == int(row["n_points"])
        assert circle.adjusted.variance_factor == pytest.approx(factor, abs=0.004)
        assert circle.adjusted.variance_factor == pytest.approx(float(row["sigma_post"]), rel=0.026)
        # 2.02e-4 m2 is what the printed standard deviations imply, 2.0e-4 what the factors do.
        sigma = np.sqrt(np.diag(circle.covariance) * 2.02e-4 / TANK_VARIANCE)
        expected = [float(row[name]) for name in ("xc_sd_m", "yc_sd_m", "radius_sd_m")]
        # Section 3 lacks a generatrix of unknown direction against the axes of the print.
        assert sigma == pytest.approx(expected, abs=6e-5 if len(ring.points) == 24 else 2.1e-4)
    assert tank.radius == pytest.approx(6.47855, abs=3e-4)
    assert tank.between is not None
    assert tank.between["volume_m3"] == pytest.approx(1252.65, abs=0.1)
    assert np.ptp([ring.circle.radius for ring in tank.sections]) == pytest.approx(0.002, abs=5e-4)


def test_a_cone_between_two_sections() -> None:
    found = volume_between_sections(np.array([2.0, 1.0]), np.array([1.0, 4.0]), np.zeros((2, 2, 2)))
    assert found["volume_m3"] == pytest.approx(np.pi * (4 + 1) / 2 * 3)
    assert found["variance_m6"] == 0


def test_variance_between_sections_against_simulation() -> None:
    random = np.random.default_rng(6)
    radius, height = np.array([6.4, 6.5, 6.45]), np.array([0.0, 3.0, 9.5])
    root = random.normal(size=(3, 2, 2)) * 0.004
    covariance = root @ np.swapaxes(root, 1, 2)
    found = volume_between_sections(radius, height, covariance)
    drawn = np.einsum("mij,kmj->kmi", root, random.normal(size=(40_000, 3, 2)))
    r, h = radius + drawn[..., 0], height + drawn[..., 1]
    area = np.pi * r**2
    volumes = ((area[:, 1:] + area[:, :-1]) / 2 * np.diff(h, axis=1)).sum(axis=1)
    assert found["sigma_m3"] == pytest.approx(volumes.std(ddof=1), rel=0.02)
    assert found["volume_m3"] == pytest.approx(volumes.mean(), abs=5 * found["sigma_m3"] / 200)


def test_volume_from_points_scatters_as_predicted(tmp_path: Path) -> None:
    random = np.random.default_rng(7)
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    root = 0.01 * np.array([[1.0, 0, 0], [0.3, 0.9, 0], [0.7, -0.4, 0.6]])
    volumes, sigmas = [], []
    cov = root @ root.T
    s = np.sqrt(np.diag(cov))
    spread = (
        f"{s[0]},{s[1]},{s[2]},{cov[0, 1] / s[0] / s[1]},{cov[0, 2] / s[0] / s[2]},{cov[1, 2] / s[1] / s[2]}"
    )
    for _ in range(120):
        lines = ["section,point,X,Y,Z,sX,sY,sZ,rXY,rXZ,rYZ"]
        for name, level in (("low", 0.0), ("high", 2.0)):
            points = np.column_stack([3 * np.cos(angle), 3 * np.sin(angle), np.full(12, level)])
            points = points + random.normal(size=(12, 3)) @ root.T
            lines += [f"{name},{i},{x},{y},{z},{spread}" for i, (x, y, z) in enumerate(points)]
        path = tmp_path / "sections.csv"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        between = measure_tank(read_ring_points(path, "Z", None)).between
        assert between is not None
        volumes.append(between["volume_m3"])
        sigmas.append(between["sigma_m3"])
    assert np.std(volumes, ddof=1) == pytest.approx(np.mean(sigmas), rel=0.25)


def test_the_vertical_axis_is_a_matter_of_names(tank_table: str, tmp_path: Path) -> None:
    tanks = []
    for vertical, axes in (("Z", "X,Y,Z"), ("Y", "Z,X,Y"), ("X", "Y,Z,X")):
        path = tmp_path / f"{vertical}.csv"
        path.write_text(tank_table.replace("point,X,Y,Z", f"point,{axes}"), encoding="utf-8")
        tanks.append(measure_tank(read_ring_points(path, vertical, 0.014)))
    for tank in tanks[1:]:
        assert tank.radius == pytest.approx(tanks[0].radius, abs=1e-12)
        assert tank.tilt == pytest.approx(tanks[0].tilt, abs=1e-9)


def test_tilt_and_wall(tmp_path: Path) -> None:
    lines = ["section,point,X,Y,Z"]
    for level in range(4):
        for i in range(16):
            a = 2 * np.pi * i / 16
            lines.append(f"{level},{i},{5 + 2 * np.cos(a) + 0.01 * level},{2 * np.sin(a)},{level}")
    path = tmp_path / "leaning.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    points = read_ring_points(path, "Z", 0.005)
    tank = measure_tank(points, 0.008)
    assert tank.tilt == pytest.approx(0.01, rel=1e-3)
    assert tank.radius == pytest.approx(1.992, abs=1e-9)
    assert tank.between is not None
    assert tank.between["volume_m3"] == pytest.approx(np.pi * 1.992**2 * 3, rel=1e-9)
    for wall in (-0.001, 2.5):
        with pytest.raises(ConfigurationError, match="thick"):
            measure_tank(points, wall)


def test_plot_and_text(tank_table: str, tmp_path: Path) -> None:
    table = tmp_path / "sections.csv"
    table.write_text(tank_table, encoding="utf-8")
    arguments = ["volume", str(table), "--sigma", "0.01414", "--height", "9.5", "--height-sigma", "0.004"]
    for name in ("one.svg", "two.svg"):
        told = CliRunner().invoke(app, [*arguments, "--plot", str(tmp_path / name)])
        assert told.exit_code == 0
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
    assert "section 4, 5 lies above its 95 % interval: no circle" in told.stdout
    assert "section 1 lies below its 95 % interval: the stated sigmas are too large" in told.stdout
    assert "by mean radius and height: V = 1252.6" in told.output
    figures = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)
    assert figures["schema"] == "photocal.volume/1"
    assert figures["sections"][4]["largest_residual_m"] == pytest.approx(0.037, abs=5e-4)
    assert figures["by_mean_radius"]["volume_m3"] == pytest.approx(
        np.pi * figures["mean_radius_m"] ** 2 * TANK_HEIGHT
    )


def test_too_large_sigmas_and_millimetres_are_told(tank_table: str, tmp_path: Path) -> None:
    table = tmp_path / "sections.csv"
    table.write_text(tank_table, encoding="utf-8")
    told = CliRunner().invoke(app, ["volume", str(table), "--sigma", "0.5"]).stdout
    assert "below its 95 % interval: the stated sigmas are too large" in told
    assert "no circle" not in told
    head, *lines = tank_table.splitlines()
    places = [line.split(",") for line in lines]
    in_mm = [",".join([*line[:2], *(str(1e3 * float(x)) for x in line[2:5]), *line[5:]]) for line in places]
    table.write_text("\n".join([head, *in_mm]) + "\n", encoding="utf-8")
    told = CliRunner().invoke(app, ["volume", str(table), "--sigma", "14"]).stdout
    assert "are the coordinates in metres?" in told


TABLE = "section,point,X,Y,Z\na,1,1,0,0\na,2,0,1,0\na,3,-1,0,0\na,4,0,-1,0\n"


@pytest.mark.parametrize(
    ("change", "more", "code", "complaint"),
    [
        (lambda t: t, [], 5, "no standard deviations"),
        (lambda t: t, ["--sigma", "-1"], 5, "positive"),
        (lambda t: t, ["--sigma", "0.1", "--radius", "1", "--radius-sigma", "0"], 5, "both"),
        (lambda t: t, ["--sigma", "0.1", "--height", "1"], 5, "given without the other"),
        (lambda t: t, ["--sigma", "0.1", "--vertical", "up"], 5, "not an axis"),
        (lambda t: t, ["--sigma", "0.1", "--plot", "rings.bmp"], 5, "known extension"),
        (lambda t: t.replace("a,4", "a,3"), ["--sigma", "0.1"], 4, "line 5: the point appears twice"),
        (lambda t: t.replace("-1,0,0", "one,0,0"), ["--sigma", "0.1"], 4, "line 4: X is 'one'"),
        (lambda t: t[: t.index("a,3")], ["--sigma", "0.1"], 6, "section a"),
        (lambda t: t.replace("X", "E"), ["--sigma", "0.1"], 4, "column X is missing"),
    ],
)
def test_complaints_are_one_line(
    photocal: Callable[..., object],
    tmp_path: Path,
    change: Callable[[str], str],
    more: list[str],
    code: int,
    complaint: str,
) -> None:
    path = tmp_path / "sections.csv"
    path.write_text(change(TABLE), encoding="utf-8")
    told = photocal("volume", path, *more)
    assert told.code == code  # type: ignore[attr-defined]
    assert complaint in told.err  # type: ignore[attr-defined]
    assert told.err.count("\n") == 1  # type: ignore[attr-defined]


def test_nothing_to_compute_from(photocal: Callable[..., object]) -> None:
    told = photocal("volume")
    assert told.code == 5  # type: ignore[attr-defined]
    assert "nothing to compute from" in told.err  # type: ignore[attr-defined]


def test_impossible_lengths_are_refused() -> None:
    for arguments in ((0.0, 0.1, 1.0, 0.1), (1.0, 0.1, float("nan"), 0.1), (1.0, -0.1, 1.0, 0.1)):
        with pytest.raises(ConfigurationError):
            cylinder_volume(*arguments)
