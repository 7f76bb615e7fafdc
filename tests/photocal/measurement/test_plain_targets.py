"""Uncoded targets in whole images: found and named where exposures predict them, refused where in doubt."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.base.errors import ConfigurationError
from photocal.base.files import digest
from photocal.block.folder import read_block, read_points
from photocal.block.project import Project, read_project
from photocal.measurement.image_file import list_images
from photocal.measurement.orientation import of_exposures
from photocal.measurement.patch_matching import ImageSource
from photocal.measurement.plain_targets import (
    FoundTargets,
    find_plain_targets,
    predicted_targets,
    targets_of_project,
)

from .site import GROUND_PX_M, SIDE, Site, flight, plate_place, texture, with_plate

Floats = NDArray[np.float64]
SIDE_M = 1.0
ATTITUDE_DEG, POSITION_M = 0.8, 0.1
# P5 has no target, P6 two of them, P7 and P8 share one.
KINDS = {"P1": "cross", "P2": "hourglass", "P3": "disc", "P4": "ring", "P5": "ring"}
KINDS |= {"P6": "disc", "P7": "cross", "P8": "cross"}
PLACES = {"P1": (-8.0, -5.5), "P2": (8.0, -5.5), "P3": (8.0, 5.5), "P4": (-8.0, 5.5), "P5": (0.0, 0.0)}
PLACES |= {"P6": (3.0, 4.0), "P7": (-3.0, -2.5), "P8": (-3.3, -2.5)}
PROJECT = """
[project]
name = "site"
crs = "local"
height = "local"
output = "work"
[images]
folder = "images"
[rig]
camera_to_antenna_m = [0.0, 0.0, -0.3]
camera_to_antenna_sigma_m = 0.01
boresight_sigma_deg = 0.2
attitude_sigma_deg = [0.1, 0.1, 0.1]
time_offset_sigma_s = 0.005
[[camera]]
id = "cam"
model = "brown-ideal"
unit = "px"
size_px = [480, 360]
parameters = { c = 452.0, K1 = -8e-8 }
estimate = ["c"]
[control]
points = "control.csv"
targets = [
    { kind = "cross", side_m = 1.0, points = ["P1", "P7", "P8"] },
    { kind = "hourglass", side_m = 1.0, points = ["P2"] },
    { kind = "disc", side_m = 1.0, points = ["P3", "P6"] },
    { kind = "ring", side_m = 1.0, points = ["P4", "P5"] },
]
"""


class Answer(Protocol):
    """What a command said."""

    code: int
    out: str
    err: str


def _plate(kind: str, turn: float) -> NDArray[np.uint8]:
    """A dark target on a light plate, seen from above; pixels of the ground's picture."""
    pixels, fine = round(1.3 * SIDE_M / GROUND_PX_M), 8
    steps = ((np.arange(pixels * fine) + 0.5) / fine - pixels / 2) * GROUND_PX_M / (SIDE_M / 2)
    x, y = np.meshgrid(steps, steps)
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    away, u, v = np.hypot(u, v), np.abs(u), np.abs(v)
    dark = {
        "cross": ((u < 1) & (v < 0.2)) | ((v < 1) & (u < 0.2)),
        "hourglass": (v > u) & (v < 1),
        "disc": away < 1,
        "ring": (away < 1) & (away > 0.5),
    }[kind]
    grey = np.where(dark, 50.0, 220.0)
    coarse = grey.reshape(pixels, fine, pixels, fine).mean(axis=(1, 3))
    return np.asarray(np.round(coarse), np.uint8)


@dataclass(frozen=True)
class Field:
    """A rendered survey: its folder, true views and where targets lie."""

    folder: Path
    site: Site
    points: dict[str, tuple[float, float]]

    @property
    def project(self) -> Project:
        return read_project(self.folder / "PROJECT.toml")

    def truth(self, image: str, point: str) -> Floats:
        place = np.array([[*self.points[point], 0.0]])
        seen = self.site.views.project(np.array([self.site.names.index(image)]), place)
        return np.asarray(seen[0])


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Field:
    folder = tmp_path_factory.mktemp("plain")
    (folder / "images").mkdir()
    rng = np.random.default_rng(2)
    ground, points = texture(9, SIDE), {}
    for name, place in PLACES.items():
        plate = _plate(KINDS[name], 0.3 if name in ("P1", "P2") else 0.0)
        points[name] = plate_place(plate, place)
        if name not in ("P5", "P8"):
            with_plate(ground, plate, place)
        if name == "P6":
            with_plate(ground, plate, (place[0] - 1.5, place[1]))
    site = flight()
    site.render(ground, folder / "images")
    roles = {"P4": "check"}
    rows = [
        f"{n},{x:.4f},{y:.4f},0.0,0.02,0.02,0.02,{roles.get(n, 'control')}" for n, (x, y) in points.items()
    ]
    (folder / "control.csv").write_text("\n".join(["point,X,Y,Z,sX,sY,sZ,role", *rows]) + "\n")
    (folder / "PROJECT.toml").write_text(PROJECT)
    sigma = np.r_[np.full(3, np.radians(ATTITUDE_DEG)), np.full(3, POSITION_M)]
    wrong = site.poses + rng.normal(0, 1, site.poses.shape) * sigma
    (folder / "work/exposures").mkdir(parents=True)
    lines = ["image,camera,X,Y,Z,omega,phi,kappa,sX,sY,sZ,so,sp,sk"]
    for name, pose in zip(site.names, wrong, strict=True):
        values = ",".join(f"{v:.6f}" for v in (*pose[3:], *np.degrees(pose[:3])))
        lines.append(f"{name},cam,{values}" + f",{POSITION_M}" * 3 + f",{ATTITUDE_DEG}" * 3)
    (folder / "work/exposures/images.csv").write_text("\n".join(lines) + "\n")
    return Field(folder, site, points)


def _sources(field: Field, cache: Path) -> list[ImageSource]:
    return [ImageSource(path, digest(path), cache) for path in list_images(field.folder / "images")]


def _found(field: Field, cache: Path, project: Project | None = None, images: int = 8) -> FoundTargets:
    own = project or field.project
    return find_plain_targets(
        _sources(field, cache)[:images],
        of_exposures(own, field.folder / "work/exposures"),
        read_points(field.folder / "control.csv"),
        own.control.plain_targets,
        1,
        lambda _: None,
    )


@pytest.fixture(scope="module")
def found(field: Field, tmp_path_factory: pytest.TempPathFactory) -> FoundTargets:
    return _found(field, tmp_path_factory.mktemp("cache"))


def test_targets_are_found_where_the_truth_is(field: Field, found: FoundTargets) -> None:
    errors = np.array([np.subtract((m.x, m.y), field.truth(m.image, m.point)) for m in found.marks])
    sigma = np.array([m.sigma for m in found.marks])
    assert np.abs(errors).max() < 0.1
    assert np.sqrt(np.mean(errors**2)) < 0.04
    # The plates are pictures of pixels themselves: what they add is within the common part.
    assert np.sqrt(np.mean((errors / sigma) ** 2)) < 1.3
    for point in ("P1", "P2", "P3", "P4"):
        whole = [
            image
            for image in field.site.names
            if (np.abs(field.truth(image, point) - [239.5, 179.5]) < [215, 155]).all()
        ]
        mine = [m.image for m in found.marks if m.point == point]
        assert len(whole) >= 2
        assert set(whole) <= set(mine), point
        assert {m.place for m in found.marks if m.point == point} == {KINDS[point]}


def test_an_absent_target_is_not_found(found: FoundTargets) -> None:
    assert found.record["predicted"] > len(found.marks)
    assert "P5" not in {m.point for m in found.marks}


def test_what_is_in_doubt_is_refused(found: FoundTargets) -> None:
    assert not {m.point for m in found.marks} & {"P6", "P7", "P8"}
    said = sorted(found.record["ambiguous"])
    assert [text[:9] for text in said] == ["point P6:", "point P7:", "point P8:"]
    assert said[0].startswith("point P6: 2 targets fit it in p")
    assert said[1].startswith("point P7: its target fits P8, too, in p")


def test_targets_of_another_size_are_none(field: Field, tmp_path: Path) -> None:
    project = field.project
    half = tuple(own.model_copy(update={"side_m": 0.6}) for own in project.control.plain_targets)
    control = project.control.model_copy(update={"targets": half})
    other = replace(project, contents=project.contents.model_copy(update={"control": control}))
    assert _found(field, tmp_path, other, 2).marks == ()


def test_targets_too_small_to_be_told_from_specks_are_named(field: Field, tmp_path: Path) -> None:
    """An eighth of a metre from 15 m through 452 px: 4 px and less."""
    project = field.project
    small = tuple(own.model_copy(update={"side_m": 0.125}) for own in project.control.plain_targets)
    control = project.control.model_copy(update={"targets": small})
    found = _found(
        field,
        tmp_path,
        replace(project, contents=project.contents.model_copy(update={"control": control})),
        2,
    )
    assert found.marks == ()
    assert found.record["predicted"] == 0
    said = dict(text.split(": ", 1) for text in found.record["too_small"])
    assert "point P1" in said
    assert re.fullmatch(r"its cross appears \d\.\d px wide at most, 12 px are needed", said["point P1"])


def test_windows_are_as_large_as_the_covariance(field: Field) -> None:
    """The truth lies within 99.9 % ellipses; an exposure ten times as unsure has ellipses as much larger."""
    project, points = field.project, read_points(field.folder / "control.csv")
    own = of_exposures(project, field.folder / "work/exposures")
    sights = predicted_targets(own, points, project.control.plain_targets)
    squares = []
    for image, seen in sights.items():
        for sight in seen:
            away = sight.place - field.truth(image, sight.point)
            squares.append(away @ np.linalg.solve(sight.covariance, away))
    assert max(squares) < 13.8
    assert 0.8 < np.mean(squares) < 3
    wide = replace(own, images=replace(own.images, covariance=own.images.covariances * 100))
    name = field.site.names[0]
    broad = {s.point: s for s in predicted_targets(wide, points, project.control.plain_targets)[name]}
    for narrow in sights[name]:
        ratio = np.linalg.det(broad[narrow.point].covariance) / np.linalg.det(narrow.covariance)
        assert 50 < np.sqrt(ratio) <= 100
    silent = replace(own, images=replace(own.images, covariance=None))
    assert predicted_targets(silent, points, project.control.plain_targets) == {}


def test_a_second_search_reads_no_image(field: Field, tmp_path: Path) -> None:
    first = _found(field, tmp_path, images=2)
    assert first.marks
    kept = sorted(tmp_path.rglob("*.npz"))
    assert len(kept) == 2
    assert _found(field, tmp_path, images=2) == first
    assert sorted(tmp_path.rglob("*.npz")) == kept


@pytest.mark.slow
def test_a_project_uses_them(field: Field, tmp_path: Path, photocal: Callable[..., Answer]) -> None:
    said = photocal(
        *("measure", field.folder / "PROJECT.toml", "-o", tmp_path / "block"),
        *("--workers", 1, "--cache", tmp_path / "cache", "--json"),
    )
    assert said.code == 0, said.err
    record = json.loads(said.out)
    plain = record["targets"]["plain"]
    assert plain["found"] == record["marks"]["targets"] >= 8
    refused = [one["subject"] for one in record["findings"] if one["code"] == "target-ambiguous"]
    assert sorted(subject[:9] for subject in refused) == ["point P6:", "point P7:", "point P8:"]
    text_of_p6 = "Ambiguous target, not used: point P6: 2 targets"
    assert any(text.startswith(text_of_p6) for text in record["warnings"])
    assert record["suspected_marks"] == []
    block = read_block(tmp_path / "block")
    seen = block.observations
    marked = {block.points.names[j] for j in seen.point.tolist() if j < len(PLACES)}
    assert marked == {"P1", "P2", "P3", "P4"}


def test_what_a_project_lacks_is_said(field: Field, tmp_path: Path) -> None:
    project, points = field.project, read_points(field.folder / "control.csv")

    def quiet(_: str, __: float | None) -> object:
        from contextlib import nullcontext

        return nullcontext(lambda _: None)

    without = targets_of_project(project, _sources(field, tmp_path), [], None, points, 1, quiet)  # type: ignore[arg-type]
    assert without.marks == ()
    (finding,) = without.findings
    assert (finding.code, finding.subject) == ("targets-not-sought", "cross, hourglass, disc, ring")
    assert not without.findings[0].small
    few = replace(points, names=("A", *points.names[1:]))
    with pytest.raises(ConfigurationError, match=r"\(cross\) name point P1, which control.csv lacks"):
        targets_of_project(project, [], [], None, few, 1, quiet)  # type: ignore[arg-type]
