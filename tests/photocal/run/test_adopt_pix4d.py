"""A block of ours, written as Pix4D leaves it and adopted: our own figures come back."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyproj import CRS

from photocal.base.errors import PhotocalError
from photocal.block.model import Block
from photocal.block.results.adjusted import adjust_block
from photocal.block.results.adjusted_block import adjusted_block
from photocal.block.results.folder import read_result
from photocal.block.results.result import Result
from photocal.block.writer import write_block
from photocal.exchange.formats import read_foreign_project
from photocal.geometry.camera import PARAMETERS, camera
from photocal.geometry.frames import ReferenceFrame
from photocal.geometry.oriented_images import given_places, given_poses
from photocal.run import adopt as module
from photocal.run.adoption_figures import adoption_text
from tests.photocal.exchange.conftest import reconstruction_of, roles_of, shown, to_adjust, with_roles
from tests.photocal.exchange.pix4d_folder import write_params, write_report
from tests.photocal.run.adopting import without_analysis

ESTIMATED = ("c", "x0", "y0", "K1", "K2", "P1", "P2")
SURVEY_M = np.array([0.02, 0.02, 0.03])
SYSTEM, MIDDLE = "EPSG:32722", np.array([677000.0, 7184000.0, 900.0])


@dataclass(frozen=True)
class Own:
    """A block of ours: as it was adjusted, with its control as surveyed, and its result."""

    given: Block
    estimated: np.ndarray[Any, np.dtype[np.float64]]
    result: Result


def made_of(folder: Path, cameras: int) -> Own:
    """Adjust a block in a map system: 0.4 px of noise, every fifth point surveyed, in turn to check."""
    values = {"c": 20.0, "x0": 0.05, "y0": -0.03, "K1": -1e-5, "K2": 1e-8, "P1": 1e-6, "P2": -2e-6}
    lenses = tuple(
        camera(f"{k}", "brown-ideal", "mm", (4608, 3456), (0.005, 0.005), values | {"c": 20.0 + 0.1 * k})
        for k in range(cameras)
    )
    made = reconstruction_of(lenses, 6 * cameras, 40 if cameras == 1 else 90)
    made = shown(made, 2)
    made = with_roles(made, "control", *("tie",) * 4, "check", *("tie",) * 4)
    # The survey errs in the map, where it was made.
    frame = ReferenceFrame(SYSTEM, MIDDLE)
    count = len(made.points.names)
    survey = np.random.default_rng(5).normal(0, SURVEY_M, (count, 3))
    surveyed_m, sigma = given_places(frame, made.points.values) + survey, np.tile(SURVEY_M, (count, 1))
    made = replace(
        made,
        images=replace(made.images, values=given_poses(frame, made.images.values)),
        points=replace(made.points, values=surveyed_m, sigma=sigma),
        frame=SYSTEM,
        height="ellipsoidal",
    )
    block = to_adjust(made, "own", 0.4)
    estimated = np.array([name in ESTIMATED for name in PARAMETERS])
    block = replace(block, cameras=tuple(replace(own, estimated=estimated) for own in block.cameras))
    (folder / "block").mkdir()
    write_block(folder / "block", block)
    adjust_block(folder / "block", folder / "run")
    result = read_result(folder / "run")
    run = adjusted_block(result)[0]
    order = {name: k for k, name in enumerate(made.points.names)}
    rows = [order[name] for name in run.points.names]
    surveyed = np.array([role != "tie" for role in roles_of(run)])
    xyz = np.where(surveyed[:, None], made.points.values[rows], run.points.values)
    points = replace(run.points, values=xyz, sigma=np.tile(SURVEY_M, (len(xyz), 1)))
    return Own(replace(run, points=points), run.points.values, result)


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Own:
    """A block of one camera."""
    return made_of(tmp_path_factory.mktemp("one"), 1)


@pytest.fixture(scope="module")
def five(tmp_path_factory: pytest.TempPathFactory) -> Own:
    """A block of five cameras, none fixed to another."""
    return made_of(tmp_path_factory.mktemp("five"), 5)


def project(folder: Path, own: Own) -> Path:
    """Write the whole project: params and report where Pix4D has them; two manual tie points."""
    params = folder / "1_initial" / "params"
    params.mkdir(parents=True)
    ties = [k for k, role in enumerate(roles_of(own.given)) if role == "tie"][:2]
    system = CRS(SYSTEM).to_wkt("WKT1_ESRI")
    offset = np.round(own.given.images.values[0, 3:])
    write_params(
        params, own.given, manual=ties, system=system, offset=offset, estimated=own.estimated, accuracy_m=50.0
    )
    sigma = [
        [each.sigma_of(name) / 0.005 for name in ("c", "x0", "y0")] for each in own.result.cameras.values()
    ]
    write_report(
        folder / "1_initial" / "report" / "html" / "field 3_report.html",
        own.given, mean_px=0.391, sigma_px=np.array(sigma),
    )  # fmt: skip
    return params


def adopted(folder: Path, output: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Adopt without analysis and certificate, which have tests of their own."""
    without_analysis(monkeypatch)
    return module.adopt(folder, output, dt.date(2026, 1, 1), lambda *_: nullcontext(lambda _: None))


@pytest.mark.parametrize("which", ["one", "five"])
def test_our_own_figures_come_back(
    tmp_path: Path, request: pytest.FixtureRequest, which: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    own: Own = request.getfixturevalue(which)
    params = project(tmp_path / "field", own)
    figures = adopted(tmp_path / "field", tmp_path / "out", monkeypatch)
    assert len(figures["cameras"]) == len(own.given.cameras)
    for theirs, ours in zip(figures["cameras"].values(), own.result.cameras.values(), strict=True):
        for name in ESTIMATED:
            assert abs(theirs["parameters"][name]["difference_in_sigmas"]) < 0.1
        # The report states sigmas of ours; those of the block adopted are the same to a few per cent.
        c = theirs["parameters"]["c"]
        assert c["their_sigma"] == pytest.approx(ours.sigma_of("c") / 0.005, rel=1e-3)
        assert c["sigma"] == pytest.approx(c["their_sigma"], rel=0.1)
    roles = {row["point"]: row["role"] for row in figures["control"]}
    expected = {
        name: role
        for name, role in zip(own.given.points.names, roles_of(own.given), strict=True)
        if role != "tie"
    }
    assert roles == expected
    sigma = dict(zip(own.result.points.names, own.result.points.sigma, strict=True))
    for row in figures["control"]:
        away = np.array(row["ours_m"]) - np.array(row["theirs_m"])
        assert np.abs(away / sigma[row["point"]]).max() < 0.1
    report = {row["what"]: row for row in figures["report"]["rows"]}
    assert report["mean reprojection error of tie points"]["theirs"] == 0.391
    assert report["rms of check points, Z"]["theirs"] == 0.023
    assert "check points by field 3_report.html" in " ".join(figures["remarks"])
    block = read_foreign_project(params).block
    assert (block.frame, block.height) == (SYSTEM, "unstated")
    assert any("do not state the reference of their heights" in line for line in figures["remarks"])
    text = adoption_text(figures)
    assert "compared with ours" in text
    assert not re.search(r"\de-\d\d\s+\+-\s+\d+e-2\d", text)


def test_the_scale_of_the_map_is_not_in_the_camera(
    tmp_path: Path, one: Own, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without its system the map is taken as Cartesian, which is said."""
    params = project(tmp_path / "field", one)
    next(params.glob("*wkt.prj")).unlink()
    figures = adopted(tmp_path / "field", tmp_path / "out", monkeypatch)
    assert any(
        "names the system of the coordinates: taken as Cartesian" in line for line in figures["remarks"]
    )


def test_a_camera_that_was_never_estimated_is_named(
    tmp_path: Path, one: Own, monkeypatch: pytest.MonkeyPatch
) -> None:
    params = project(tmp_path / "field", one)
    cameras = next(params.glob("*3_calibrated_camera_parameters.txt"))
    lines = cameras.read_text().split("\n")
    count = len(one.given.images.names)
    for k in range(count):
        at = 8 + 10 * k
        assert one.given.images.names[k] in lines[at]
        lines[at + 1 : at + 4] = ["3990 0 2304", "0 3990 1728", "0 0 1"]
        lines[at + 4 : at + 6] = ["0 0 0", "0 0"]
    cameras.write_text("\n".join(lines))
    figures = adopted(tmp_path / "field", tmp_path / "out", monkeypatch)
    assert any("was never estimated" in line for line in figures["remarks"])
    (own,) = figures["cameras"].values()
    truth = one.result.cameras["0"]
    assert own["parameters"]["c"]["ours"] == pytest.approx(
        truth.value("c") / 0.005, abs=4 * own["parameters"]["c"]["sigma"]
    )


Mutation = Callable[[bytes], bytes]


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    file=st.integers(0, 12),
    kind=st.sampled_from(["cut", "byte", "line", "twice", "empty", "word", "gone"]),
    at=st.floats(0, 1, exclude_max=True),
    word=st.sampled_from([b"nan", b"1e400", b"-1", b"", b"\xff\xfe", b"1,5", b"0", b"x" * 300]),
)
def test_mutilated_folders_are_read_or_refused_in_a_line(
    tmp_path_factory: pytest.TempPathFactory, one: Own, file: int, kind: str, at: float, word: bytes
) -> None:
    folder = tmp_path_factory.mktemp("mutilated")
    params = project(folder, one)
    files = sorted(params.iterdir())
    path = files[file % len(files)]
    content = path.read_bytes()
    k = int(at * len(content))
    lines = content.split(b"\n")
    n = int(at * len(lines))
    cells = lines[n].split(b" ")
    cells[int(at * len(cells))] = word
    path.write_bytes(
        {
            "cut": content[:k],
            "byte": content[:k] + (word or b"\0")[:1] + content[k + 1 :],
            "line": b"\n".join(lines[:n] + lines[n + 1 :]),
            "twice": b"\n".join([*lines[: n + 1], *lines[n:]]),
            "empty": b"",
            "word": b"\n".join([*lines[:n], b" ".join(cells), *lines[n + 1 :]]),
            "gone": b"",
        }[kind]
    )
    if kind == "gone":
        path.unlink()
    refusal: PhotocalError | None = None
    try:
        foreign = read_foreign_project(folder)
    except PhotocalError as failure:
        refusal = failure
    if refusal is not None:
        assert "\n" not in str(refusal)
        return
    assert np.isfinite(foreign.block.observations.values).all()
