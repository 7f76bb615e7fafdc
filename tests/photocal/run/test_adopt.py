"""`photocal adopt`: projects that were adjusted by us come back from every format as the same camera."""

from __future__ import annotations

import datetime as dt
import re
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.base.errors import IllPosedError, InputMalformedError
from photocal.block.folder import read_block
from photocal.block.model import ROLES, Block
from photocal.block.results.adjusted import adjust_block
from photocal.block.results.adjusted_block import adjusted_block
from photocal.block.results.folder import read_result
from photocal.block.writer import write_block
from photocal.exchange.exporting import Choices
from photocal.exchange.formats import named, read_foreign_project
from photocal.exchange.pinhole import to_pinhole, to_vision
from photocal.geometry.camera import PARAMETERS, Model, camera
from photocal.geometry.frames import ReferenceFrame
from photocal.geometry.oriented_images import given_places
from photocal.run import adopt as module
from photocal.run.adoption_figures import adoption_text, rounded
from tests.photocal.exchange.conftest import reconstruction_of, roles_of, shown, to_adjust, with_roles
from tests.photocal.run.adopting import without_analysis

ESTIMATED = ("c", "x0", "y0", "K1", "K2", "P1", "P2")
SURVEY_M = np.array([0.02, 0.02, 0.03])
SHIFT_M = 0.5
OFFSET = np.array([677000.0, 7184000.0, 900.0])


@pytest.fixture(scope="module")
def adjusted(tmp_path_factory: pytest.TempPathFactory) -> Block:
    """An adjustment with the lens model of vision programs."""
    return made_of("brown-ideal", tmp_path_factory)


@pytest.fixture(scope="module")
def observed(tmp_path_factory: pytest.TempPathFactory) -> Block:
    """The same with that of photogrammetric ones."""
    return made_of("brown-observed", tmp_path_factory)


def made_of(model: Model, tmp_path_factory: pytest.TempPathFactory) -> Block:
    """An adjustment of ours: 0.4 px of noise, every fifth point surveyed to 2 and 3 cm."""
    folder = tmp_path_factory.mktemp("own")
    values = {"c": 20.0, "x0": 0.05, "y0": -0.03, "K1": -1e-5, "K2": 1e-8, "P1": 1e-6, "P2": -2e-6}
    made = reconstruction_of((camera("1", model, "mm", (4608, 3456), (0.005, 0.005), values),))
    made = with_roles(shown(made, 2), "control", "tie", "tie", "tie", "tie")
    count = len(made.points.names)
    survey = np.random.default_rng(5).normal(0, SURVEY_M, (count, 3))
    sigma = np.tile(SURVEY_M, (count, 1))
    made = replace(made, points=replace(made.points, values=made.points.values + survey, sigma=sigma))
    # Set-ups of photogrammetric programs state 1 px; of the others the sigma is estimated.
    block = to_adjust(made, "own", 0.4 if model == "brown-ideal" else 1.0)
    estimated = np.array([name in ESTIMATED for name in PARAMETERS])
    block = replace(block, cameras=tuple(replace(own, estimated=estimated) for own in block.cameras))
    (folder / "block").mkdir()
    write_block(folder / "block", block)
    adjust_block(folder / "block", folder / "run")
    # Control keeps its survey: what programs take over is what was measured.
    run = adjusted_block(read_result(folder / "run"))[0]
    control = np.array([role == "control" for role in roles_of(run)])
    order = {name: k for k, name in enumerate(made.points.names)}
    rows = [order[name] for name in run.points.names]
    xyz = np.where(control[:, None], made.points.values[rows], run.points.values)
    points = replace(run.points, values=xyz, sigma=np.tile(SURVEY_M, (len(xyz), 1)))
    return replace(run, points=points)


def quiet(*_: Any) -> Any:
    return nullcontext(lambda _: None)


def adopted(folder: Path, monkeypatch: pytest.MonkeyPatch, **changes: Any) -> dict[str, Any]:
    """Adopt without analysis and certificate, which have tests of their own."""
    without_analysis(monkeypatch)
    return module.adopt(folder, folder / "adopted", dt.date(2026, 1, 1), quiet, **changes)


def largest(figures: dict[str, Any]) -> float:
    """Largest difference of the cameras, in standard deviations."""
    (own,) = figures["cameras"].values()
    assert set(own["parameters"]) >= set(ESTIMATED)
    return max(abs(float(p["difference_in_sigmas"])) for p in own["parameters"].values() if p["sigma"])


@pytest.mark.parametrize("form", ["opf", "micmac", "photomodeler", "dbat"])
def test_the_same_camera(
    tmp_path: Path, request: pytest.FixtureRequest, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = request.getfixturevalue("observed" if form in ("photomodeler", "dbat") else "adjusted")
    named(form).write(tmp_path, given, Choices())
    figures = adopted(tmp_path, monkeypatch)
    assert largest(figures) < 0.1
    assert "theirs" in adoption_text(figures)


ERRORS_HEAD = (
    "imageName, cameraIndex, cameraName, X_opt, Y_opt, Z_opt, X_gps, Y_gps, Z_gps, X_acc, Y_acc, Z_acc, "
    "Omega, Phi, Kappa, X_uncertainty, Y_uncertainty, Z_uncertainty, Omega_uncertainty, Phi_uncertainty, "
    "Kappa_uncertainty, inlierProb"
)
GROUND_HEAD = (
    "GCP label, GCP measured X, GCP measured Y, GCP measured Z, GCP estimated X, GCP estimated Y, "
    "GCP estimated Z, GCP weight, GCP visible in # images"
)


def digits(values: Any) -> list[str]:
    """Numbers as Pix4Dmapper writes them."""
    return [f"{float(value):.20f}" for value in values]


def pix4d(folder: Path, given: Block) -> None:
    """Write a params folder as its description has it; its first two tie points are manual ones."""
    own = given.cameras[0]
    pinhole, _ = to_pinhole(own, "Pix4D")
    rotation, _ = to_vision(given.images.values)
    width, height = own.size_px
    head = "fileName imageWidth imageHeight \n" + "a line of the head\n" * 6 + "\n"
    blocks, errors, bingo = [], [ERRORS_HEAD], []
    manual = [k for k, role in enumerate(roles_of(given)) if role == "tie"][:2]
    marked = [k for k, role in enumerate(roles_of(given)) if role == "control"] + manual
    for k, name in enumerate(given.images.names):
        place = given.images.values[k, 3:]
        rows: list[Any] = [[pinhole.fx, 0, pinhole.cx + 0.5], [0, pinhole.fy, pinhole.cy + 0.5], [0, 0, 1]]
        rows += [[pinhole.k1, pinhole.k2, pinhole.k3], [pinhole.p1, pinhole.p2], place, *rotation[k].tolist()]
        blocks.append("\n".join([f"{name} {width} {height}", *(" ".join(digits(row)) for row in rows)]))
        there = place + OFFSET
        # All positions lie too low, by 2 cm as the user typed.
        cells = [
            *there,
            *(there - [0, 0, SHIFT_M]),
            0.02,
            0.02,
            0.02,
            *np.degrees(given.images.values[k, :3]),
        ]
        cells += [0.004] * 3 + [0.002] * 3 + [0.99]
        errors.append(", ".join([name, "0", "Own Camera_20.0_4608x3456 (RGB)(1)", *digits(cells)]))
        bingo.append(f"{Path(name).stem} H_{width * own.pitch[0]}_{height * own.pitch[1]}")
        for ray in np.flatnonzero(given.observations.image == k):
            x = (given.observations.values[ray, 0] - (width - 1) / 2) * own.pitch[0]
            y = ((height - 1) / 2 - given.observations.values[ray, 1]) * own.pitch[1]
            point = given.observations.point[ray]
            prefix = "GCP_" if point in marked else ""
            bingo.append(" ".join([f"{prefix}{given.points.names[point]}", *digits([x, y])]))
        bingo.append("-99")
    ground = [GROUND_HEAD]
    for k in marked:
        there = given.points.values[k] + OFFSET
        # Of manual tie points one has zeros, the other what the program computed in an earlier state.
        earlier = dict(zip(manual, (np.zeros(3), there - np.array([0, 0, 0.28])), strict=False))
        measured = earlier.get(k, there)
        weight = 1.0 if k in manual else 0.9999997
        ground.append(", ".join([given.points.names[k], *digits([*measured, *there, weight]), "4"]))
    for ending, text in (
        ("calibrated_camera_parameters.txt", head + "\n".join(blocks)),
        ("calibrated_external_camera_parameters_error.txt", "\n".join(errors)),
        ("offset.xyz", " ".join(digits(OFFSET))),
        ("measured_estimated_gcps_position.txt", "\n".join(ground)),
        (
            "measured_gcps_position.txt",
            "\n".join(" ".join(digits(given.points.values[k] + OFFSET)) for k in marked),
        ),
        ("tp_bingo.txt", "\n".join(bingo)),
    ):
        (folder / f"field 3_{ending}").write_text(text + "\n")


def test_a_pix4d_project(tmp_path: Path, adjusted: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    params = tmp_path / "1_initial" / "params"
    params.mkdir(parents=True)
    pix4d(params, adjusted)
    foreign = read_foreign_project(tmp_path)
    assert foreign.block.name == "field 3"
    assert foreign.block.images.values[0, 3:] == pytest.approx(adjusted.images.values[0, 3:] + OFFSET)
    roles = [ROLES[k] for k in foreign.block.points.role]
    assert roles.count("control") == roles_of(adjusted).count("control")
    figures = adopted(tmp_path, monkeypatch)
    # The positions weigh in here and did not there; their common shift is found and told.
    shift = figures["positions"]
    assert shift["common_shift_m"]["z"] == pytest.approx(SHIFT_M, abs=4 * shift["sigma_m"]["z"])
    assert "not of one datum" in adoption_text(figures)
    assert largest(figures) < 0.1


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (3650.25431, 0.0384, "3650.254"),
        (-9.41e-33, 2e-9, "0"),
        (-0.0175091796, 0.00031, "-0.01751"),
        (12345.678, 230.0, "1.235e+04"),
        (0.25, None, "0.25"),
    ],
)
def test_parameters_are_rounded_by_their_sigma(value: float, sigma: float | None, text: str) -> None:
    assert rounded(value, sigma) == text


def test_parameters_are_in_the_units_of_the_program(
    tmp_path: Path, adjusted: Block, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pix4D's radial coefficients are of coordinates divided by the focal length."""
    pix4d(tmp_path, adjusted)
    next(tmp_path.glob("*_error.txt")).unlink()
    text = adoption_text(adopted(tmp_path, monkeypatch))
    pinhole, _ = to_pinhole(adjusted.cameras[0], "Pix4D")
    shown = {line.split()[0]: line.split()[1] for line in text.splitlines() if line.startswith("  ")}
    assert float(shown["K1"]) == pytest.approx(pinhole.k1, rel=0.01)
    assert float(shown["c"]) == pytest.approx(pinhole.fy, rel=1e-5)


def test_manual_tie_points_are_no_control(tmp_path: Path, adjusted: Block) -> None:
    pix4d(tmp_path, adjusted)
    foreign = read_foreign_project(tmp_path)
    points = foreign.block.points
    manual = [
        name for name, role in zip(adjusted.points.names, roles_of(adjusted), strict=True) if role == "tie"
    ][:2]
    assert [ROLES[points.role[points.names.index(name)]] for name in manual] == ["tie", "tie"]
    assert np.isnan(points.values[[points.names.index(name) for name in manual]]).all()
    assert "2 points have marks but were not surveyed: tie points" in foreign.remarks
    control = {
        name
        for name, role in zip(adjusted.points.names, roles_of(adjusted), strict=True)
        if role == "control"
    }
    assert {points.names[k] for k in np.flatnonzero(points.of_role("control"))} == control
    assert set(foreign.adjusted) == control


def test_variants_of_a_pix4d_project(tmp_path: Path, adjusted: Block) -> None:
    pix4d(tmp_path, adjusted)
    foreign = read_foreign_project(tmp_path)
    assert any("have no accuracy" in remark for remark in foreign.remarks)
    assert foreign.position_sigma[0].tolist() == [0.02, 0.02, 0.02]
    assert foreign.pose_sigma[0] == pytest.approx([*np.radians([0.002] * 3), *[0.004] * 3])
    # A table of its own with accuracies, line ends of another system, a comment and blank lines; an image
    # without a position.
    control = [k for k, role in enumerate(roles_of(adjusted)) if role == "control"]
    rows = [
        ", ".join(
            [adjusted.points.names[k], *digits([*adjusted.points.values[k] + OFFSET, 0.05, 0.05, 0.07])]
        )
        for k in control
    ]
    table = next(tmp_path.glob("*3_measured_gcps_position.txt"))
    table.write_bytes("\r\n\r\n".join(["# label, X, Y, Z, accuracies", *rows]).encode())
    errors = next(tmp_path.glob("*_error.txt"))
    lines = errors.read_text().splitlines()
    cells = lines[1].split(", ")
    lines[1] = ", ".join([*cells[:6], "none", "none", "none", *cells[9:]])
    errors.write_bytes("\r\n".join(lines).encode())
    again = read_foreign_project(tmp_path)
    assert again.block.points.sigma[again.block.points.of_role("control")][0].tolist() == [0.05, 0.05, 0.07]
    assert np.isnan(again.position[0]).all()
    assert np.isfinite(again.position[1:]).all()
    bingo = next(tmp_path.glob("*tp_bingo.txt"))
    bingo.write_text(bingo.read_text().replace("_23.04_17.28", "_RGB"))
    line = "#Focal Length mm assuming a sensor width of 23.03999999999999914735x17.28000000000000113687mm\n"
    stated = tmp_path / "field 3_calibrated_internal_camera_parameters.cam"
    for text in ("", line.replace("23.03", "23.03.04")):
        stated.write_text(text)
        with pytest.raises(InputMalformedError, match="no sensor width in mm"):
            read_foreign_project(tmp_path)
    stated.write_text(line)
    assert len(read_foreign_project(tmp_path).block.observations.image) == len(
        foreign.block.observations.image
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("imageName, ", "name, ", "line 1: is not a header with a column imageName"),
        (", 0.98999999999999999112", "", "line 2: has 21 cells where the head has 22"),
    ],
)
def test_a_table_of_errors_without_its_head_is_refused(
    tmp_path: Path, adjusted: Block, old: str, new: str, message: str
) -> None:
    pix4d(tmp_path, adjusted)
    errors = next(tmp_path.glob("*_error.txt"))
    errors.write_text(errors.read_text().replace(old, new, 1))
    with pytest.raises(InputMalformedError, match=message):
        read_foreign_project(tmp_path)


def test_surveyed_points_without_names_are_told(tmp_path: Path, adjusted: Block) -> None:
    pix4d(tmp_path, adjusted)
    next(tmp_path.glob("*measured_estimated*")).unlink()
    foreign = read_foreign_project(tmp_path)
    assert foreign.block.points.of_role("tie").all()
    assert any("has no names of points: no control" in remark for remark in foreign.remarks)


@pytest.mark.parametrize("cut", [False, True])
def test_a_damaged_pix4d_project_is_refused(tmp_path: Path, adjusted: Block, cut: bool) -> None:
    pix4d(tmp_path, adjusted)
    cameras = next(tmp_path.glob("*calibrated_camera_parameters.txt"))
    text = cameras.read_text()
    # A word in a matrix; and the last row of the last rotation cut within.
    bottom = " ".join(digits([0, 0, 1]))
    assert bottom in text
    cameras.write_text(text.rsplit(" ", 1)[0] if cut else text.replace(bottom, bottom.replace(" 0", " x", 1)))
    with pytest.raises(InputMalformedError):
        read_foreign_project(tmp_path)


def test_a_pix4d_project_without_positions_is_the_same_camera(
    tmp_path: Path, adjusted: Block, monkeypatch: pytest.MonkeyPatch
) -> None:
    pix4d(tmp_path, adjusted)
    next(tmp_path.glob("*_error.txt")).unlink()
    assert largest(adopted(tmp_path, monkeypatch)) < 0.1


@pytest.mark.parametrize("form", ["colmap", "opensfm"])
def test_models_with_a_list_of_control(
    tmp_path: Path, adjusted: Block, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ties = np.array([role == "tie" for role in roles_of(adjusted)])
    rays = ties[adjusted.observations.point]
    seen = adjusted.observations.rows(rays)
    seen = replace(seen, point=(np.cumsum(ties) - 1)[seen.point])
    bare = replace(adjusted, points=adjusted.points.only(ties), observations=seen)
    named(form).write(tmp_path, bare, Choices())
    # The list is in map coordinates, whose scale is not that of the ground.
    mapped = given_places(ReferenceFrame("EPSG:32722", OFFSET), adjusted.points.values)
    rows = [
        " ".join([*(repr(float(v)) for v in mapped[j]), repr(float(x)), repr(float(y))])
        + f" {adjusted.images.names[i]} P{adjusted.points.names[j]}"
        for i, j, (x, y) in zip(
            adjusted.observations.image,
            adjusted.observations.point,
            adjusted.observations.values,
            strict=True,
        )
        if not ties[j]
    ]
    (tmp_path / "gcp_list.txt").write_text("\n".join(["EPSG:32722", *rows]) + "\n")
    figures = adopted(tmp_path, monkeypatch)
    assert len(figures["control"]) == int((~ties).sum())
    assert largest(figures) < 0.1
    assert read_block(tmp_path / "adopted" / "block").frame == "EPSG:32722"
    # What keeps a list from being used is said.
    twice = [re.sub(r"(\S+) (\S+)( \S+ P)", lambda m: f"{2e4 + float(m[1])} {m[2]}{m[3]}", r) for r in rows]
    other = [re.sub(r" (\S+ P)", r" x\1", row) for row in rows]
    for changed, said in ((twice, "lie outside of their images"), (other, "in no image of the project (x")):
        (tmp_path / "gcp_list.txt").write_text("\n".join(["EPSG:32722", *changed]) + "\n")
        with pytest.raises(IllPosedError, match=re.escape(said)):
            adopted(tmp_path, monkeypatch)


def test_gross_errors_are_taken_out_and_told(
    tmp_path: Path, adjusted: Block, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One ray in fifty is wrong by 30 px, and two control points are exchanged: the camera stays the same."""
    pixels, xyz = adjusted.observations.values.copy(), adjusted.points.values.copy()
    role = np.array(roles_of(adjusted))
    rays = np.bincount(adjusted.observations.point, minlength=len(role))
    wrong = np.flatnonzero(
        (role[adjusted.observations.point] == "tie") & (rays[adjusted.observations.point] == rays.max())
    )[::50]
    pixels[wrong] += [30.0, -20.0]
    a, b = np.flatnonzero((role == "control") & (rays > 1))[[1, 5]]
    xyz[[a, b]] = xyz[[b, a]]
    seen, points = replace(adjusted.observations, values=pixels), replace(adjusted.points, values=xyz)
    pix4d(tmp_path, replace(adjusted, points=points, observations=seen))
    figures = adopted(tmp_path, monkeypatch)
    names = adjusted.points.names
    listed = (tmp_path / "adopted" / "rays-left-out.csv").read_text().splitlines()[1:]
    left = {tuple(line.split(",")[:2]) for line in listed}
    injected = {
        (adjusted.images.names[adjusted.observations.image[k]], names[adjusted.observations.point[k]])
        for k in wrong
    }
    assert injected <= left
    # Rays of points that lose one of two may go with it.
    assert len(left) < 2 * len(injected) + 10
    told = " ".join(figures["remarks"])
    assert f"{names[a]} and {names[b]} are exchanged" in told or f"{names[b]} and {names[a]} are" in told
    assert {row["point"] for row in figures["control"] if row["role"] == "check"} == {names[a], names[b]}
    assert largest(figures) < 2.0
    found = {row["group"]: row["found"] for row in figures["sigmas"]}
    assert found["image coordinates of tie points"] == pytest.approx(0.4, rel=0.1)


def test_names_of_images_may_have_blanks_and_come_twice(tmp_path: Path, adjusted: Block) -> None:
    count = len(adjusted.images.names)
    # The same names in two folders, of which the program writes the last part only.
    names = tuple(f"S\u00e3o Jo\u00e3o {k % (count // 2):04d}.JPG" for k in range(count))
    pix4d(tmp_path, replace(adjusted, images=replace(adjusted.images, names=names)))
    bingo = next(tmp_path.glob("*tp_bingo.txt"))
    bingo.write_text(bingo.read_text().replace(" H_", " Canon EOS 5D_H_"))
    foreign = read_foreign_project(tmp_path)
    assert len(set(foreign.block.images.names)) == count
    assert np.isfinite(foreign.position).all()
    seen = foreign.block.observations
    assert np.bincount(seen.image).tolist() == np.bincount(adjusted.observations.image).tolist()
    places = {name: k for k, name in enumerate(foreign.block.points.names)}
    k = len(adjusted.observations.image) - 1
    (row,) = np.flatnonzero(
        (seen.image == adjusted.observations.image[k])
        & (seen.point == places[adjusted.points.names[adjusted.observations.point[k]]])
    )
    assert seen.values[row] == pytest.approx(adjusted.observations.values[k], abs=1e-6)
