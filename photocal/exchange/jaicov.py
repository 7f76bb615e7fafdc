"""JAICOV and AICON 3D Studio: .ior, .eor, .obc, .phc and .scale files of one name, into a block.

Image coordinates in mm, x right, y up, from the middle of the sensor. The distortion is added to the
projection (`brown-ideal`), balanced by R0; A1..A3, B1, B2 and C1, C2 are our K1..K3, P1, P2 and B1, B2 with
the same sign (C additive); the principal distance Ck is negative. Orientation as X, Y, Z (mm), omega, phi,
kappa (rad) of our own rotation. Object space in mm, in the block in m. Several cameras stand one after the
other in the .ior file, five lines each. Standard deviations in the .obc and
.phc files are results: the a priori one of the image coordinates stands in the report (.htm). Which
parameters of the camera were estimated is not in the files: all but A3, C1 and C2 are.
"""

import re
from pathlib import Path

import numpy as np

from photocal.adjustment.network import RELATIONS, Relations
from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.block.model import Block, Images, ObjectPoints
from photocal.exchange import parts
from photocal.exchange.exporting import Choices
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.parts import Row, known, of_cameras, whole_numbers, write_rows
from photocal.exchange.source import (
    Line,
    image_size,
    number,
    numbers,
    read_lines,
    require_readable,
)
from photocal.geometry.camera import Camera, camera, pixel_to_plane
from photocal.geometry.conversion import Conversion, converted

SUFFIXES = (".ior", ".eor", ".obc", ".phc")
MM = 1e-3
# A distance between two points and its standard deviation, m.
Bar = tuple[str, str, float, float]
_A_PRIORI = re.compile(rb"S0 apriori:\s*([^\s<)]+)")
_TERMS = ("K1", "K2", "K3", "P1", "P2", "B1", "B2")


def read(path: Path) -> ForeignProject:
    """Read a project with its report."""
    return ForeignProject("AICON", read_jaicov(path), weighted=True)


def read_jaicov(path: Path, sigma_mm: float | None = None) -> Block:
    """Read a JAICOV project; without `sigma_mm`, of an image coordinate, its report tells it."""
    files = {suffix: path.with_suffix(suffix) for suffix in SUFFIXES}
    sigma = _a_priori(path.with_suffix(".htm")) if sigma_mm is None else sigma_mm
    cameras = _cameras(read_lines(files[".ior"]), files[".ior"])
    names, which, poses = _orientations(read_lines(files[".eor"]), [camera.id for camera in cameras])
    points, xyz = _objects(read_lines(files[".obc"]))
    marks = _marks(read_lines(files[".phc"]), set(names), set(points), sigma)
    seen = parts.observations(marks, names, points, "mm", "photo")
    bars = files[".phc"].with_suffix(".scale")
    scale = read_scale_bars(bars) if bars.exists() else ()
    # The report is an input where it tells the standard deviation.
    report = [path.with_suffix(".htm")] if sigma_mm is None else []
    read = [*files.values(), *([bars] if bars.exists() else []), *report]
    return parts.block(
        path.stem,
        cameras,
        Images(tuple(names), np.array(which, dtype=np.int64), poses),
        ObjectPoints(tuple(points), xyz),
        seen,
        read,
        relations=_distances(scale, points, bars),
    )


def read_scale_bars(path: Path) -> tuple[Bar, ...]:
    """Read a .scale file."""
    bars = []
    for line in read_lines(path):
        row = re.fullmatch(r'\s*\S+\s+"[^"]*"\s+(\S+)\s+(\S+)\s+(\S+)\s+(\S+)\s+([01])\s*', line.text)
        if row is None:
            raise line.malformed("is not a row of a scale bar", "is the file truncated?")
        first, second, length, sigma, on = row.groups()
        if on == "1":
            sizes = number(length, line.place, "length") * MM, number(sigma, line.place, "sigma") * MM
            bars.append((first, second, *sizes))
    return tuple(bars)


def _distances(bars: tuple[Bar, ...], points: list[str], place: Path) -> Relations:
    position = {name: k for k, name in enumerate(points)}
    for first, second, length, sigma in bars:
        lost = [name for name in (first, second) if name not in position]
        if lost:
            raise InputMalformedError(f"a scale bar ends at the unknown point {lost[0]}", where=place)
        if not (length > 0 and sigma > 0):
            raise InputMalformedError("a scale bar has no length or no sigma", where=place)
    return Relations(
        np.full(len(bars), list(RELATIONS).index("distance")),
        np.array([position[first] for first, _, _, _ in bars], dtype=np.int64),
        np.array([position[second] for _, second, _, _ in bars], dtype=np.int64),
        np.array([length for _, _, length, _ in bars]),
        np.array([sigma for _, _, _, sigma in bars]),
    )


def _a_priori(report: Path) -> float:
    if report.is_file():
        require_readable(report)
        match = _A_PRIORI.search(report.read_bytes())
        if match:
            return number(match.group(1).decode("latin-1"), report, "S0 a priori")
    raise ConfigurationError(
        "the a priori standard deviation of the image coordinates is not stated",
        f"put the report {report.name} beside it",
        where=report.with_suffix(".phc"),
    )


def _cameras(lines: list[Line], path: Path) -> tuple[Camera, ...]:
    if not lines or len(lines) % 5:
        raise InputMalformedError(
            f"has {len(lines)} lines where every camera has 5", "is the file truncated?", where=path
        )
    cameras = tuple(_camera(lines[k : k + 5]) for k in range(0, len(lines), 5))
    parts.require_unique([camera.id for camera in cameras], "camera", path)
    return cameras


def _camera(lines: list[Line]) -> Camera:
    head, third, decentering, affinity, sensor = (
        numbers(line.text, line.place, "interior orientation", count)
        for line, count in zip(lines, (8, 1, 2, 2, 4), strict=True)
    )
    if not head[2] < 0:
        raise lines[0].malformed("the principal distance is not negative")
    size_px = image_size(sensor[2], sensor[3], lines[4].place)
    if not min(sensor[:2]) > 0:
        raise lines[4].malformed("the sensor has no size")
    return camera(
        f"{int(head[0])}",
        "brown-ideal",
        "mm",
        size_px,
        (sensor[0] / size_px[0], sensor[1] / size_px[1]),
        {"c": -head[2], "x0": head[3], "y0": head[4], "K1": head[5], "K2": head[6], "K3": third[0]}
        | {"P1": decentering[0], "P2": decentering[1], "B1": affinity[0], "B2": affinity[1]},
        estimate=("c", "x0", "y0", "K1", "K2", "P1", "P2"),
        reference_radius=head[7],
    )


def _orientations(lines: list[Line], cameras: list[str]) -> tuple[list[str], list[int], Floats]:
    names, which, poses = [], [], []
    for line in lines:
        row = numbers(line.text, line.place, "exterior orientation", 11)
        if f"{row[1]:g}" not in cameras:
            raise line.malformed(f"has camera {row[1]:g}, which is not in the .ior file")
        names.append(str(int(row[0])))
        which.append(cameras.index(f"{row[1]:g}"))
        poses.append([*row[5:8], *(value * MM for value in row[2:5])])
    parts.require_unique(names, "image", lines[0].path if lines else None)
    return names, which, np.array(poses).reshape(-1, 6)


def _objects(lines: list[Line]) -> tuple[list[str], Floats]:
    names, xyz = [], []
    for line in lines:
        cells = line.text.split(maxsplit=1)
        row = numbers(cells[1] if len(cells) > 1 else "", line.place, "object point", 10)
        names.append(cells[0])
        xyz.append([value * MM for value in row[:3]])
    parts.require_unique(names, "object point", lines[0].path if lines else None)
    return names, np.array(xyz).reshape(-1, 3)


def _marks(lines: list[Line], images: set[str], points: set[str], sigma: float) -> list[parts.Mark]:
    marks = []
    for line in lines:
        cells = line.text.split()
        if len(cells) != 11:
            raise line.malformed(f"has {len(cells)} values where an image point has 11", "is it truncated?")
        if cells[9] == "1" and cells[0] in images and cells[1] in points:
            x, y = number(cells[2], line.place, "x"), number(cells[3], line.place, "y")
            marks.append(parts.Mark(cells[0], cells[1], x, y, (sigma, sigma), line.place))
    return marks


def write(stem: Path, given: Block, choices: Choices) -> tuple[Conversion, ...]:
    """Write .ior, .eor, .obc and .phc files."""
    if any(camera.unit != "mm" for camera in given.cameras):
        raise InputMalformedError("JAICOV files have cameras in mm", "give the pixel pitch")
    made = tuple(converted(camera, "brown-ideal", "additive", _TERMS) for camera in given.cameras)
    cameras = whole_numbers([camera.id for camera in given.cameras])
    images, points = whole_numbers(given.images.names), whole_numbers(given.points.names)
    ior = [row for name, camera in zip(cameras, made, strict=True) for row in _interior(name, camera.camera)]
    write_rows(stem.with_suffix(".ior"), ior)
    eor: list[Row] = [
        [name, cameras[camera], *(pose[3:] / MM).tolist(), *pose[:3].tolist(), "0", "0", "3"]
        for name, camera, pose in zip(images, given.images.camera.tolist(), given.images.values, strict=True)
    ]
    write_rows(stem.with_suffix(".eor"), eor)
    rays = np.bincount(given.observations.point, minlength=len(points))
    sigma = known(given.points.sigma) / MM
    obc: list[Row] = [
        [name, *(xyz / MM).tolist(), *s.tolist(), str(count), "1", "1", "0"]
        for name, xyz, s, count in zip(points, given.points.values, sigma, rays, strict=True)
    ]
    write_rows(stem.with_suffix(".obc"), obc)
    write_rows(stem.with_suffix(".phc"), _mark_rows(given, choices.residuals_of(given), images, points))
    return made


def _interior(name: str, camera: Camera) -> list[Row]:
    v = camera.value
    size = np.array(camera.size_px) * camera.pitch
    return [
        [name, "-999", -v("c"), v("x0"), v("y0"), v("K1"), v("K2"), camera.reference_radius],
        [v("K3")],
        [v("P1"), v("P2")],
        [v("B1"), v("B2")],
        [*size.tolist(), *(str(side) for side in camera.size_px)],
    ]


def _mark_rows(given: Block, residuals_px: Floats, images: list[str], points: list[str]) -> list[Row]:
    seen, pitch = given.observations, of_cameras(given, "pitch")
    plane = pixel_to_plane(of_cameras(given, "size_px"), pitch, seen.values)
    residuals = np.nan_to_num(residuals_px * pitch * [1.0, -1.0])
    return [
        [images[i], points[j], *xy.tolist(), 0.0, 0.0, *r.tolist(), "1", "1", "1"]
        for i, j, xy, r in zip(seen.image, seen.point, plane, residuals, strict=True)
    ]
