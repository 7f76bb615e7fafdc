"""ODM's gcp_list.txt and geo.txt.

gcp_list.txt: first line the coordinate system (EPSG:n, WGS84 UTM zone, or a PROJ string), then X, Y, Z,
column, row, image and an optional name, separated by blanks; pixels x right, y down, the centre of the
upper-left pixel is (0, 0), as ours; rows with the same coordinates are the same point. geo.txt: coordinate
system, then image, X, Y and optional Z, yaw, pitch, roll (deg), horizontal and vertical accuracy (m).
Yaw, pitch and roll turn from north, east, down to a body whose camera looks down and whose image has its
upper edge forward: all three are 0 for a camera that looks down, its upper edge to the north; a gimbal's
pitch of -90 is 0 here. Neither states the kind of the heights: that stays with the reader. Source:
OpenDroneMap documentation, "Ground control points" and "Image geolocation files"; ODM's `compute_opk`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError, InputMalformedError
from photocal.exchange.parts import digits, require_no_blanks, require_unique
from photocal.exchange.reconstruction import Choices, Reconstruction
from photocal.exchange.source import Line, number, numbers, read_lines
from photocal.geometry.conversion import Conversion
from photocal.geometry.rotation import matrix_from_angles

_CAMERA_TO_BODY = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# Some metres to the north, in which meridians are straight.
_NORTH_DEG = 1e-4
_NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class GroundMark:
    """A ground point seen in an image.

    xyz: in the file's coordinate system; geographic ones as longitude, latitude (deg), height (m).
    """

    point: str
    xyz: tuple[float, float, float]
    column: float
    row: float
    image: str
    place: str


@dataclass(frozen=True)
class ImagePosition:
    """Where an image was taken, as far as geo.txt knows.

    xyz: in the file's coordinate system; height NaN when not given.
    yaw_pitch_roll_deg: NaN when not given.
    accuracy_m: horizontal and vertical; NaN when not given.
    """

    image: str
    xyz: tuple[float, float, float]
    yaw_pitch_roll_deg: tuple[float, float, float]
    accuracy_m: tuple[float, float]


def read_gcp_list(path: Path) -> tuple[str, tuple[GroundMark, ...]]:
    """Read gcp_list.txt.

    raises InputNotFoundError, InputMalformedError: also when one name has two places, or a point is marked
        twice in an image.
    """
    crs, lines = _head(path)
    marks = []
    names: dict[tuple[float, float, float], str] = {}
    for line in lines:
        cells = _cells(line.text)
        if len(cells) < 6:
            raise line.malformed(
                f"has {len(cells)} cells where X Y Z column row image were expected",
                "complete the row, or is the file cut?",
            )
        x, y, z, column, row = numbers(" ".join(cells[:5]), line.place, "ground point")
        known = names.setdefault((x, y, z), cells[6] if len(cells) > 6 else f"point{len(names) + 1}")
        if len(cells) > 6 and cells[6] != known:
            raise line.malformed(f"points {known} and {cells[6]} have the same coordinates")
        marks.append(GroundMark(known, (x, y, z), column, row, cells[5], line.place))
    require_unique(list(names.values()), "a point with other coordinates,", path)
    require_unique([f"{mark.point} in image {mark.image}" for mark in marks], "point", path)
    return crs, tuple(marks)


def _cells(text: str) -> list[str]:
    """Cells between blanks, semicolons, or commas; a comma may be decimal where no point is."""
    if len(text.split()) == 1 and ";" not in text:
        return text.split(",")
    cells = text.replace(";", " ").split()
    if any("." in cell for cell in cells[:5]):
        return cells
    return [*(cell.replace(",", ".") for cell in cells[:5]), *cells[5:]]


def write_gcp_list(path: Path, crs: str, marks: Sequence[GroundMark]) -> None:
    """Write gcp_list.txt."""
    require_no_blanks(name for mark in marks for name in (mark.image, mark.point))
    rows = (f"{digits((*mark.xyz, mark.column, mark.row))} {mark.image} {mark.point}" for mark in marks)
    path.write_text("\n".join([crs, *rows]) + "\n", encoding="utf-8", newline="\n")


def read_geo(path: Path) -> tuple[str, tuple[ImagePosition, ...]]:
    """Read geo.txt."""
    crs, lines = _head(path)
    positions = []
    for line in lines:
        cells = line.text.split()
        if not 3 <= len(cells) <= 9:
            raise line.malformed(
                f"has {len(cells)} cells where image X Y [Z yaw pitch roll accuracies] were expected"
            )
        # Orientation may be skipped by writing "-" or "nan"; both mean not known.
        values = [
            float("nan") if cell.lower() in ("-", "nan") and k >= 2 else number(cell, line.place, "position")
            for k, cell in enumerate(cells[1:])
        ]
        x, y, z, yaw, pitch, roll, h, v = values + [float("nan")] * (8 - len(values))
        positions.append(ImagePosition(cells[0], (x, y, z), (yaw, pitch, roll), (h, v)))
    require_unique([position.image for position in positions], "image", path)
    return crs, tuple(positions)


def angles_of_geo(to_camera: Floats) -> Floats:
    """Return yaw, pitch, roll as geo.txt means them, degrees (n, 3); NaN where the rotation is unknown.

    to_camera (n, 3, 3): from east, north, up to camera axes (x right, y up in the image, z backwards).
    """
    # The body's forward is the camera's y, its right the x, its down the direction of view.
    to_body = _CAMERA_TO_BODY @ to_camera @ _NED_TO_ENU
    pitch = np.arcsin(np.clip(-to_body[:, 0, 2], -1.0, 1.0))
    yaw = np.arctan2(to_body[:, 0, 1], to_body[:, 0, 0]) % (2 * np.pi)
    roll = np.arctan2(to_body[:, 1, 2], to_body[:, 2, 2])
    return np.asarray(np.degrees(np.stack([yaw, pitch, roll], axis=1)))


def write_geo(path: Path, crs: str, positions: Sequence[ImagePosition]) -> None:
    """Write geo.txt; what is not known at the end of a row is left out, in between it is "nan"."""
    rows = []
    for position in positions:
        values = [*position.xyz, *position.yaw_pitch_roll_deg, *position.accuracy_m]
        last = max((k for k, value in enumerate(values) if not np.isnan(value)), default=1)
        rows.append(f"{position.image} {digits(values[: last + 1])}")
    path.write_text("\n".join([crs, *rows]) + "\n", encoding="utf-8", newline="\n")


def export(folder: Path, given: Reconstruction, _: Choices | None = None) -> tuple[Conversion, ...]:
    """Write gcp_list.txt of the control points and geo.txt of the images."""
    if given.frame == "local":
        raise ConfigurationError(
            "the block is in a local frame, but ODM's lists name a coordinate reference system",
            'adjust in one, for example frame = "EPSG:31982"',
        )
    # A compound name has the heights' system behind a plus.
    crs = given.frame.split("+")[0]
    control = {j for j, role in enumerate(given.roles) if role == "control"}
    marks = [
        GroundMark(given.point_names[j], (x, y, z), column, row, given.image_names[i], "")
        for i, j, (column, row), (x, y, z) in zip(
            given.image.tolist(),
            given.point.tolist(),
            given.pixels.tolist(),
            given.xyz[given.point].tolist(),
            strict=True,
        )
        if j in control
    ]
    if marks:
        write_gcp_list(folder / "gcp_list.txt", crs, marks)
    to_camera = matrix_from_angles(given.poses[:, :3]) @ _to_map(crs, given.poses[:, 3], given.poses[:, 4])
    angles = angles_of_geo(to_camera)
    positions = [
        ImagePosition(name, (x, y, z), (yaw, pitch, roll), (float(np.hypot(sx, sy)), sz))
        for name, (x, y, z), (yaw, pitch, roll), (sx, sy, sz) in zip(
            given.image_names,
            given.poses[:, 3:].tolist(),
            angles.tolist(),
            given.pose_sigma[:, 3:].tolist(),
            strict=True,
        )
    ]
    require_no_blanks(given.image_names)
    write_geo(folder / "geo.txt", crs, positions)
    return ()


def _to_map(crs: str, x: Floats, y: Floats) -> Floats:
    """Return the rotations from east, north, up to the axes of a map at places on it (n, 3, 3)."""
    from pyproj import Transformer

    way = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    lon, lat = way.transform(x, y)
    north_x, north_y = way.transform(lon, lat + _NORTH_DEG, direction="INVERSE")
    convergence = np.arctan2(north_x - x, north_y - y)
    s, c, zero, one = np.sin(convergence), np.cos(convergence), np.zeros_like(x), np.ones_like(x)
    turn = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]])
    return np.asarray(np.moveaxis(turn, -1, 0))


def _head(path: Path) -> tuple[str, list[Line]]:
    lines = read_lines(path, comment="#")
    first = lines[0].text.strip() if lines else ""
    if not first or not any(first.upper().startswith(key) for key in ("EPSG:", "WGS84", "+PROJ", "+INIT")):
        raise InputMalformedError(
            f"begins with {first[:40]!r}, not with a coordinate system",
            "write EPSG:n, WGS84 UTM zone, or a PROJ string in the first line",
            where=path,
        )
    return first, lines[1:]
