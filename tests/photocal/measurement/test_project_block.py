"""A project measured as a whole: tie points, coded plates and marks."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from photocal.adjustment.adjust import adjust
from photocal.base.codec import same
from photocal.block.folder import read_block
from photocal.block.model import ROLES, Block
from photocal.block.network import assemble
from photocal.block.project import read_project
from photocal.measurement import oriented_ties
from photocal.measurement.markers import dictionary
from photocal.measurement.options import MeasureOptions
from photocal.measurement.picture_block import measure

from .site import SIDE, Site, flight, plate_place, texture, with_plate

PLACES = {"P1": (-9.0, -6.0), "P2": (9.0, -6.0), "P3": (9.0, 6.0), "P4": (-9.0, 6.0), "P5": (0.5, 0.3)}


class Answer(Protocol):
    """What a command said."""

    code: int
    out: str
    err: str


def _plate(code: int) -> NDArray[np.uint8]:
    """Half a metre of black and white with a margin."""
    marker = cv2.aruco.generateImageMarker(dictionary("apriltag_36h11"), code, 64)
    return np.asarray(cv2.copyMakeBorder(marker, 10, 10, 10, 10, cv2.BORDER_CONSTANT, value=255), np.uint8)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Site, dict[str, tuple[float, float]]]:
    """A rendered survey with five plates, of which one has no name in the project."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "images").mkdir()
    ground, lain = texture(5, SIDE), {}
    for code, (name, place) in enumerate(PLACES.items()):
        with_plate(ground, _plate(code), place)
        lain[name] = plate_place(_plate(code), place)
    with_plate(ground, _plate(77), (-3.0, 0.0))
    own = flight()
    own.render(ground, folder / "images")
    Image.new("L", (300, 200)).save(folder / "images/other.png")
    roles = {"P5": "check"}
    rows = [f"{n},{x:.4f},{y:.4f},0.0,0.01,0.01,0.01,{roles.get(n, 'control')}" for n, (x, y) in lain.items()]
    (folder / "control.csv").write_text("point,X,Y,Z,sX,sY,sZ,role\n" + "\n".join(rows) + "\n")
    truth = own.views.project(np.array([1]), np.array([[*lain["P5"], 0.0]]))
    marks = [f"p2.png,P5,{truth[0, 0] + 0.1:.3f},{truth[0, 1]:.3f},0.3,0.3", "none.png,P1,5,5,1,1"]
    (folder / "marks.csv").write_text("image,point,x,y,sx,sy\n" + "\n".join(marks) + "\n")
    # As another program writes it: no ending, the corner of the upper-left pixel at (0, 0).
    truth = own.views.project(np.array([2]), np.array([[*lain["P5"], 0.0]])) + 0.5
    (folder / "pix4d.txt").write_text(f"images/p3,P5,{truth[0, 0]:.3f},{truth[0, 1]:.3f},1.0\n")
    (folder / "project.toml").write_text(
        """
[project]
name = "site"
crs = "local"
height = "local"
output = "work"
[images]
folder = "images"
[[camera]]
id = "cam"
model = "brown-ideal"
unit = "mm"
size_px = [480, 360]
pitch_mm = 0.01
parameters = { c = 4.5 }
estimate = ["c", "K1"]
[control]
points = "control.csv"
marks = "marks.csv"
[control.targets]
dictionary = "apriltag_36h11"
side_m = 1.28
names = { "0" = "P1", "1" = "P2", "2" = "P3", "3" = "P4", "4" = "P5" }
"""
    )
    return folder, own, lain


@pytest.mark.slow
def test_a_project_becomes_a_block(
    site: tuple[Path, Site, dict[str, tuple[float, float]]], tmp_path: Path, photocal: Callable[..., Answer]
) -> None:
    folder, own, lain = site
    said = photocal(
        "measure",
        folder / "project.toml",
        "--marks",
        folder / "pix4d.txt",
        "-o",
        tmp_path / "block",
        "--workers",
        1,
        "--cache",
        tmp_path / "cache",
        "--json",
    )
    assert said.code == 0, said.err
    record = json.loads(said.out)
    assert record["left_out"] == [
        {
            "image": "other.png",
            "reason": "its 300 x 200 px are not those of camera cam",
            "code": "other-size",
        }
    ]
    assert "other.png: their size differs from" in next(
        finding["text"] for finding in record["findings"] if finding["code"] == "image-left-out"
    )
    assert record["unknown_marks"] == ["P1 in none.png"]
    assert any("code 77" in name for name in record["unknown_targets"])
    block = read_block(tmp_path / "block")
    assert block.cameras[0].value("c") == 4.5
    seen = block.observations
    # Every plate is found where the truth puts it, as well as its own sigma says.
    misses, sigmas = [], []
    for k in np.flatnonzero(seen.point < 5):
        name, image = block.points.names[seen.point[k]], int(block.images.names[seen.image[k]][1]) - 1
        place = np.array([[*lain[name], 0.0]])
        misses.append(seen.values[k] - own.views.project(np.array([image]), place)[0])
        sigmas.append(seen.sigma[k])
    assert len(misses) >= 15
    automatic = np.array([s[0] < 0.3 for s in sigmas])
    assert np.count_nonzero(~automatic) == 2
    assert np.abs(np.array(misses)[~automatic]).max() == pytest.approx(0.1, abs=0.01)
    assert np.sqrt(np.mean(np.array(misses)[automatic] ** 2)) < 0.05
    # The block orients and calibrates: truth within what the adjustment says of itself.
    assembly = assemble(block)
    solution = adjust(assembly.network)
    # Sigmas of tie points are not taken below 0.02 px, which they reach here.
    assert solution.variance_factor < 1.25
    assert np.sqrt(np.mean(solution.residuals**2)) < 0.02 * 0.01
    assert record["rms_px"] == pytest.approx(np.sqrt(np.mean(solution.residuals**2)) / 0.01, rel=0.2)
    assert record["suspected_marks"] == []
    centres = assembly.frame.to_given(solution.exposures[:, 3:])
    order = [int(name[1]) - 1 for name in block.images.names]
    sigma = np.sqrt(np.diagonal(solution.exposure_covariance[:, 3:, 3:], axis1=1, axis2=2))
    assert (np.abs(centres - own.poses[order, 3:]) < 4 * sigma).all()
    check = assembly.points.tolist().index(block.points.names.index("P5"))
    found = assembly.frame.to_given(solution.points)[check]
    assert np.abs(found - [*lain["P5"], 0.0]).max() < 0.02


def test_a_project_that_nothing_places_is_free_and_says_so(
    site: tuple[Path, Site, dict[str, tuple[float, float]]], tmp_path: Path, photocal: Callable[..., Answer]
) -> None:
    folder, _, _ = site
    text = (folder / "project.toml").read_text()
    bare = "\n".join(
        line
        for line in text.splitlines()
        if not line.startswith(("marks", "[control.", "dict", "side_", "names"))
    )
    (folder / "bare.toml").write_text(bare)
    said = photocal(
        "measure", folder / "bare.toml", "-o", tmp_path / "b", "--workers", 1, "--cache", tmp_path / "cache"
    )
    assert said.code == 0
    block = read_block(tmp_path / "b")
    assert block.datum == "free"
    assert set(block.points.role.tolist()) == {ROLES.index("tie")}
    record = json.loads((tmp_path / "b/measurement.json").read_text())
    told = {finding["code"]: finding["text"] for finding in record["findings"]}
    assert "adjusted free, in a local system" in told["block-not-placed"]
    assert "0 of 4 are marked in two pictures" in told["control-not-used"]


@pytest.mark.slow
def test_a_mark_that_moves_lets_no_picture_be_searched_or_matched_again(
    site: tuple[Path, Site, dict[str, tuple[float, float]]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was measured of tie points is found in the cache, while the mark itself is used as it is now."""
    folder, cache = tmp_path / "site", tmp_path / "cache"
    shutil.copytree(site[0], folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "own"))

    def marked() -> tuple[set[Path], set[Path], Block]:
        """Files of both caches, and the block."""
        options = MeasureOptions(workers=1, cache=cache, marks=(folder / "pix4d.txt",))
        block = measure(read_project(folder / "project.toml"), options).block
        return set(cache.rglob("*.npz")), set((tmp_path / "own").rglob("*.npz")), block

    matched, searched, before = marked()
    assert matched
    assert searched
    mark, *others = (folder / "marks.csv").read_text().splitlines()[1:]
    image, point, x, *rest = mark.split(",")
    lines = ["image,point,x,y,sx,sy", ",".join([image, point, str(float(x) + 0.6), *rest]), *others]
    (folder / "marks.csv").write_text("\n".join(lines) + "\n")
    again, _, after = marked()
    assert again == matched
    assert marked()[1] == searched
    rays, rays_after = (
        block.observations.values[block.points.of_role("tie")[block.observations.point]]
        for block in (before, after)
    )
    assert np.array_equal(rays, rays_after)
    place = after.points.names.index("P5")
    of_mark = [
        np.sort(block.observations.values[block.observations.point == place, 0]) for block in (before, after)
    ]
    assert np.abs(of_mark[1] - of_mark[0]).max() == pytest.approx(0.6)


def _replaced(name: str, old: str, new: str) -> Callable[[Path], None]:
    """A change of a file of a site, first place only."""

    def change(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return change


def _without_first(folder: Path) -> None:
    (folder / "images" / "p1.png").rename(folder / "p1.png")


CHANGES: dict[str, Callable[[Path], None]] = {
    "a mark moved": _replaced("marks.csv", "p2.png,P5,301", "p2.png,P5,302"),
    "its sigma": _replaced("marks.csv", ",0.3,0.3", ",0.9,0.9"),
    "a role": _replaced("control.csv", ",check", ",control"),
    "a coordinate": _replaced("control.csv", ",0.0,0.01", ",0.02,0.01"),
    "a standard deviation": _replaced("control.csv", ",0.01,0.01,0.01,", ",0.05,0.05,0.05,"),
    "an option of the camera": _replaced("project.toml", '["c", "K1"]', '["c", "K1", "K2"]'),
    "its principal distance": _replaced("project.toml", "c = 4.5", "c = 4.45"),
    "its lens as given": _replaced("project.toml", 'lens = "unknown"', 'lens = "given"'),
    "a picture taken away": _without_first,
}


@pytest.fixture(scope="module")
def measured_once(
    site: tuple[Path, Site, dict[str, tuple[float, float]]], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Path, Block]:
    """A site that was measured, with the lens that its rays prefer; the cache of that, and the block."""
    folder, cache = tmp_path_factory.mktemp("once") / "site", tmp_path_factory.mktemp("cache")
    shutil.copytree(site[0], folder)
    _replaced("project.toml", 'folder = "images"', 'folder = "images"\nlens = "unknown"')(folder)
    options = MeasureOptions(workers=1, cache=cache)
    return folder, cache, measure(read_project(folder / "project.toml"), options).block


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
def test_what_changes_is_measured_as_from_nothing(
    measured_once: tuple[Path, Path, Block], tmp_path: Path, change: str
) -> None:
    once, cache, before = measured_once
    shutil.copytree(once, tmp_path / "site")
    CHANGES[change](tmp_path / "site")
    project = read_project(tmp_path / "site" / "project.toml")
    again, new = (
        measure(project, MeasureOptions(workers=1, cache=folder)).block
        for folder in (cache, tmp_path / "new")
    )
    assert same(again, new)
    assert not same(again, before)


@pytest.mark.slow
def test_a_picture_that_comes_back_is_measured_as_from_nothing(
    site: tuple[Path, Site, dict[str, tuple[float, float]]], tmp_path: Path
) -> None:
    folder = tmp_path / "site"
    shutil.copytree(site[0], folder)
    _without_first(folder)
    project, options = read_project(folder / "project.toml"), MeasureOptions(workers=1, cache=tmp_path / "a")
    assert "p1.png" not in measure(project, options).block.images.names
    (folder / "p1.png").rename(folder / "images" / "p1.png")
    new = measure(project, replace(options, cache=tmp_path / "b")).block
    assert same(measure(project, options).block, new)


@pytest.mark.slow
def test_what_large_pictures_show_is_matched_halved_first_and_ends_at_the_same_places(
    site: tuple[Path, Site, dict[str, tuple[float, float]]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pictures of 480 pixels, taken for large ones; the rendered views tell where each ray should lie."""
    folder, own, _ = site
    options = MeasureOptions(workers=1, cache=tmp_path / "cache")
    monkeypatch.setattr(oriented_ties, "USUAL_PX", 300.0)
    monkeypatch.setattr(oriented_ties, "LARGE_PX", 400.0)
    measured = measure(read_project(folder / "project.toml"), options)
    block = measured.block
    assembly = assemble(block)
    solution = adjust(assembly.network)
    assert solution.variance_factor < 1.25
    assert np.sqrt(np.mean(solution.residuals**2)) < 0.02 * 0.01
    centres = assembly.frame.to_given(solution.exposures[:, 3:])
    order = [int(name[1]) - 1 for name in block.images.names]
    sigma = np.sqrt(np.diagonal(solution.exposure_covariance[:, 3:, 3:], axis1=1, axis2=2))
    assert (np.abs(centres - own.poses[order, 3:]) < 4 * sigma).all()


@pytest.mark.slow
def test_good_positions_are_not_blamed_for_the_principal_point(
    tmp_path: Path, photocal: Callable[..., Answer]
) -> None:
    """A principal point 8 px off moves images by 0.36 m, to and fro with the strips: 18 sigmas."""
    (tmp_path / "images").mkdir()
    own = flight()
    own = replace(own, camera=own.camera.with_values([450.0, 8.0, *own.camera.values[2:]]))
    own.render(texture(5, SIDE), tmp_path / "images")
    places = own.poses[:, 3:] + np.random.default_rng(1).normal(0, 0.02, (8, 3)) + [500000, 7000000, 100]
    rows = [
        f"{name} {east:.3f} {north:.3f} {height:.3f} 0 0 0 0.02 0.02"
        for name, (east, north, height) in zip(own.names, places, strict=True)
    ]
    (tmp_path / "geo.txt").write_text("EPSG:32722\n" + "\n".join(rows) + "\n")
    (tmp_path / "project.toml").write_text(
        """
[project]
name = "site"
crs = "EPSG:32722"
height = "ellipsoidal"
output = "work"
[images]
folder = "images"
positions = "geo.txt"
[[camera]]
id = "cam"
model = "brown-ideal"
unit = "px"
size_px = [480, 360]
parameters = { c = 450 }
estimate = ["c", "x0", "y0", "K1"]
prior_sigma = { c = 10, x0 = 10, y0 = 10 }
"""
    )
    said = photocal("measure", tmp_path / "project.toml", "-o", tmp_path / "block", "--workers", 1, "--json")
    assert said.code == 0, said.err
    codes = {finding["code"] for finding in json.loads(said.out)["findings"]}
    assert not codes & {"position-off", "positions-worse"}
    adjusted = adjust(assemble(read_block(tmp_path / "block")).network)
    assert adjusted.cameras[0][1] == pytest.approx(
        8.0, abs=3.3 * np.sqrt(adjusted.camera_covariance[0][1, 1])
    )


def test_pictures_of_no_camera_of_the_project_are_named(
    tmp_path: Path, photocal: Callable[..., Answer]
) -> None:
    rng = np.random.default_rng(1)
    for name in ("a", "b", "c"):
        Image.fromarray(rng.integers(0, 255, (200, 300), dtype=np.uint8)).save(tmp_path / f"{name}.png")
    (tmp_path / "project.toml").write_text(
        '[project]\nname = "p"\ncrs = "local"\nheight = "local"\noutput = "work"\n[images]\nfolder = "."\n'
        '[[camera]]\nid = "cam"\nmodel = "brown-ideal"\nunit = "px"\nsize_px = [400, 300]\n'
        "parameters = { c = 400.0 }\n"
    )
    said = photocal("measure", tmp_path / "project.toml", "-o", tmp_path / "block", "--workers", 1)
    assert said.code != 0
    assert "0 of 3 images can be used; a.png: its 300 x 200 px are not those of camera cam" in said.err
