"""Planned close-range networks: Monte Carlo by a generator of the test's own, closed forms, refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from typer.testing import CliRunner

from photocal.base.errors import PhotocalError
from photocal.block.model import Block
from photocal.block.results.adjusted import adjust_network
from photocal.commands.cli import app
from photocal.planning.network_file import NetworkPlan, plan_network

NETWORKS = Path(__file__).parents[3] / "configs" / "networks"
Floats = NDArray[np.float64]
SMALL = """# A small field.
[camera]
focal_mm = 8.8
pixel_um = 2.41
image_px = [5472, 3648]
image_sigma_px = 0.2
estimate = ["c", "x0", "y0", "K1"]
[object.field]
width_m = 3.0
height_m = 3.0
columns = 4
rows = 4
relief_m = 0.3
[[stations]]
ring = { radius_m = 3.0, height_m = 3.5, count = 4, first_deg = 45 }
rolls_deg = [0, 90]
[[distance]]
between = ["1.1", "4.4"]
sigma_m = 0.0005
"""


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> NetworkPlan:
    path = tmp_path_factory.mktemp("network") / "small.toml"
    path.write_text(SMALL)
    return plan_network(path)


def seen_by_hand(block: Block, photo: int, targets: Floats, c: float) -> Floats:
    """Collinearity as textbooks write it, from omega, phi, kappa, term by term."""
    (o, p, k), place = block.images.values[photo, :3], block.images.values[photo, 3:]
    dx, dy, dz = (targets - place).T
    u = (
        np.cos(p) * np.cos(k) * dx
        + (np.cos(o) * np.sin(k) + np.sin(o) * np.sin(p) * np.cos(k)) * dy
        + (np.sin(o) * np.sin(k) - np.cos(o) * np.sin(p) * np.cos(k)) * dz
    )
    v = (
        -np.cos(p) * np.sin(k) * dx
        + (np.cos(o) * np.cos(k) - np.sin(o) * np.sin(p) * np.sin(k)) * dy
        + (np.sin(o) * np.cos(k) + np.cos(o) * np.sin(p) * np.sin(k)) * dz
    )
    w = np.sin(p) * dx - np.sin(o) * np.cos(p) * dy + np.cos(o) * np.cos(p) * dz
    return np.column_stack([-c * u / w, -c * v / w])


def test_photos_look_at_their_target_and_show_what_the_eye_would(small: NetworkPlan) -> None:
    block = small.block
    assert block.images.names == ("1.1", "1.2", "2.1", "2.2", "3.1", "3.2", "4.1", "4.2")
    for photo in range(len(block.images.names)):
        middle = seen_by_hand(block, photo, np.zeros((1, 3)), 8.8)
        assert middle == pytest.approx(0.0, abs=1e-12)
        of = block.observations.image == photo
        xyz = block.points.values[block.observations.point[of]]
        assert block.observations.values[of] == pytest.approx(seen_by_hand(block, photo, xyz, 8.8), abs=1e-9)
    # A level photo has a vertical edge upright; its rolled twin shows it turned by a quarter.
    edge = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    upright = np.diff(seen_by_hand(block, 0, edge, 8.8), axis=0)[0]
    rolled = np.diff(seen_by_hand(block, 1, edge, 8.8), axis=0)[0]
    assert upright[0] == pytest.approx(0.0, abs=1e-12)
    assert upright[1] > 0
    assert rolled == pytest.approx([upright[1], 0.0], abs=1e-12)


def test_sigmas_are_those_of_adjusted_networks_with_errors(small: NetworkPlan) -> None:
    """200 networks with random errors of images and tape scatter as the plan has predicted."""
    rng, block, runs = np.random.default_rng(41), small.block, 200
    points, cameras = [], []
    for _ in range(runs):
        seen, tape = block.observations, block.relations
        noisy = replace(
            block,
            observations=replace(seen, values=seen.values + rng.normal(0, 0.2 * 2.41e-3, seen.values.shape)),
            relations=replace(tape, values=tape.values + rng.normal(0, 0.0005, tape.values.shape)),
        )
        made = adjust_network(noisy)
        points.append(made.points.values)
        cameras.append(made.camera().values)
    free = [list(small.camera.lens.names).index(name) for name in ("c", "x0", "y0", "K1")]
    for found, predicted in (
        (np.array(points).reshape(runs, -1), small.result.points.sigma.ravel()),
        (np.array(cameras)[:, free], np.array([small.camera.sigma_of(n) for n in ("c", "x0", "y0", "K1")])),
    ):
        ratio = (runs - 1) * found.var(axis=0, ddof=1) / predicted**2
        # All of them at once, at 1 %.
        low, high = stats.chi2(runs - 1).ppf([0.005 / len(predicted), 1 - 0.005 / len(predicted)])
        assert (ratio > low).all()
        assert (ratio < high).all()
    # Correlations by Fisher's z, all six at 1 %.
    above = np.triu_indices(4, 1)
    z = np.arctanh(np.atleast_2d(np.corrcoef(np.array(cameras)[:, free].T))[above])
    expected = np.arctanh(small.camera.correlation_of(("c", "x0", "y0", "K1"))[above])
    assert np.abs(z - expected).max() < stats.norm.ppf(1 - 0.005 / 6) / np.sqrt(runs - 3)


def test_the_normal_case_of_two_photos(tmp_path: Path) -> None:
    """Held photos 1 m apart, 10 m above a target in their middle: X and Z by the textbook's formula."""
    table = tmp_path / "targets.csv"
    others = [f"c{k},{x},{y},0" for k, (x, y) in enumerate([(-2, -2), (2, -2), (2, 2), (-2, 2)])]
    table.write_text("\n".join(["point,X,Y,Z", "m,0,0,0", *others]) + "\n")
    path = tmp_path / "pair.toml"
    path.write_text(
        "[camera]\nfocal_mm = 20.0\npixel_um = 5.0\nimage_px = [4000, 3000]\n"
        "image_sigma_px = 0.4\nestimate = []\n"
        '[object]\npoints = "targets.csv"\n'
        "[[stations]]\nat = [[-0.5, 0, 10]]\ntarget = [-0.5, 0, 0]\n[[stations]]\nat = [[0.5, 0, 10]]\n"
        "target = [0.5, 0, 0]\n"
        '[datum]\ncontrol = ["c0", "c1", "c2", "c3"]\ncontrol_sigma_m = [1e-9, 1e-9, 1e-9]\n'
    )
    made = plan_network(path)
    held = replace(made.block.images, sigma=np.zeros((2, 6)))
    result = adjust_network(replace(made.block, images=held))
    sigma = result.points.sigma[result.points.names.index("m")]
    image = 0.4 * 5e-6 * 10 / 20e-3
    # Albertz and Kreiling: s_Z = h^2 / (b c) s_px with s_px = sqrt(2) s; X and Y are means of two rays.
    assert sigma == pytest.approx(
        [image / np.sqrt(2), image / np.sqrt(2), 10 / 1 * np.sqrt(2) * image], rel=1e-3
    )


@pytest.mark.parametrize("path", sorted(NETWORKS.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_networks_by_the_command(path: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["plan-network", str(path), "-o", str(tmp_path / "out"), "--json"])
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    written = json.loads((tmp_path / "out" / "network.json").read_text())
    assert written == figures
    assert (tmp_path / "out" / "network.png").stat().st_size > 10_000
    # The block that is written gives the same adjustment.
    again = adjust_network(Block.read(tmp_path / "out" / "block"))
    rms = np.sqrt((again.points.sigma**2).mean(axis=0))
    assert list(figures["sigma_m"].values()) == pytest.approx(rms, rel=1e-6)


def test_the_tank_as_its_study_found_it() -> None:
    """Printed: twelve stations so that three photos show each point; sC 2.4 and 2.5 mm (tests 7 and 8)."""
    made = plan_network(NETWORKS / "tank.toml")
    stations = {
        (int(point), tuple(made.block.images.values[photo, 3:]))
        for photo, point in zip(made.block.observations.image, made.block.observations.point, strict=True)
    }
    seen = np.bincount([point for point, _ in stations])
    assert seen.min() == 3
    assert 2.4e-3 / 2 < made.result.points.sigma.mean() < 2 * 2.4e-3


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("point,X,Y,Z,nX\na,0,0,0,1\n", "incomplete normal"),
        ("point,X,Y,Z,nX,nY,nZ\na,0,0,0,0,0,1\nb,1,0,0,0,0,0\n", "line 3: the normal has no length"),
        ("point,X,Y,Z\na,0,0,0\na,1,0,0\n", "twice"),
    ],
)
def test_refused_targets(tmp_path: Path, rows: str, said: str) -> None:
    (tmp_path / "targets.csv").write_text(rows)
    path = tmp_path / "own.toml"
    field = SMALL[SMALL.index("[object.field]") : SMALL.index("[[stations]]")]
    path.write_text(SMALL.replace(field, '[object]\npoints = "targets.csv"\n'))
    done = CliRunner().invoke(app, ["plan-network", str(path)])
    assert isinstance(done.exception, PhotocalError)
    assert said in str(done.exception)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("radius_m = 3.0, height_m = 3.5", "radius_m = 30.0, height_m = 1.0"), "sees 0 targets"),
        (('"4.4"', '"9.9"'), "target 9.9 is not on the object"),
        (('"K1"]', '"K9"]'), "K9"),
        (("columns = 4", "columns = 1"), "columns"),
        (
            ("[object.field]", "[object]\npoints = 'a.csv'\n[object.field]"),
            "one of field, cylinder and points",
        ),
        (("[[distance]]", "[datum]\nheld = '7'\n[[distance]]"), "no photo 7 is planned"),
        (("rolls_deg = [0, 90]", "target = [3, 0, 3.5]\nat = [[3, 0, 3.5]]"), "either ring or at"),
    ],
)
def test_refusals(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    path = tmp_path / "small.toml"
    path.write_text(SMALL.replace(*change))
    done = CliRunner().invoke(app, ["plan-network", str(path)])
    assert isinstance(done.exception, PhotocalError)
    assert said in str(done.exception)
