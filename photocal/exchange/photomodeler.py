"""PhotoModeler's text export ("export text file", solution with marks) into a block.

Image coordinates in px from the upper-left corner of the upper-left pixel, x right, y down (half a pixel more
than ours); interior orientation in mm from that corner, K and P with the opposite sign of ours; pixels of
format / size, which need not be square; distortion corrects the measurement (`brown-observed`). Orientation
as X, Y, Z (project unit, taken as m), kappa, phi, omega (deg) of our own rotation. Standard deviations of
control points in the export are a posteriori: those of the survey come from a table of control points. A
mark with sigma 0 (a SmartPoint) has the default of 1 px.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError, InputMalformedError
from photocal.block.model import Block
from photocal.exchange import parts
from photocal.exchange.dbat_tables import read_rows
from photocal.exchange.photomodeler_export import Export, read_export
from photocal.exchange.reconstruction import Reconstruction, of_block
from photocal.exchange.source import fingerprint, read_lines
from photocal.geometry.camera import Camera, camera


def read_control(path: Path) -> dict[str, tuple[Floats, Floats]]:
    """Read a table of control points: id, name, X, Y, Z and, optionally, three standard deviations."""
    widths = {len(line.text.split(",")) for line in read_lines(path)}
    layout = "id,label,x,y,z" + (",sx,sy,sz" if widths != {5} else "")
    fields = ("id", "label", "x", "y", "z", "sx", "sy", "sz")
    rows = list(read_rows(path, layout, fields))
    parts.require_unique([row.name("id") for row in rows], "control point", path)
    return {
        row.name("id"): (np.array([row.value(axis) for axis in "xyz"]), np.array(row.sigma())) for row in rows
    }


def read_positions(path: Path) -> dict[str, tuple[Floats, float]]:
    """Read a table of camera positions: image, X, Y, Z, standard deviation of each coordinate.

    returns: position and its standard deviation by image, m.
    raises InputNotFoundError, InputMalformedError.
    """
    rows = list(read_rows(path, "label,x,y,z,sxyz", ("label", "x", "y", "z", "sxyz")))
    parts.require_unique([row.name("label") for row in rows], "image", path)
    return {
        row.name("label"): (np.array([row.value(axis) for axis in "xyz"]), row.sigma()[0]) for row in rows
    }


def block_from_export(
    export: Export,
    control: dict[str, tuple[Floats, Floats]],
    *,
    positions: dict[str, tuple[Floats, float]] | None = None,
    own_camera: Camera | None = None,
) -> Block:
    """Make a block from an export and a table of control points."""
    place = export.file.path
    shift = _shift(export, control, place)
    names = [photo.name for photo in export.photos]
    parts.require_unique(names, "photo", place)
    observed = {mark.point for mark in export.marks}
    idle = [name for name in export.points if name not in observed and name not in control]
    if idle:
        raise InputMalformedError(
            f"object point {', '.join(idle[:5])} has no observation at all",
            where=place,
            remedy="export its marks, or take it out",
        )
    points = [parts.PointEntry(name, "control", xyz, sigma) for name, (xyz, sigma) in control.items()]
    tie = dict.fromkeys([*export.points, *observed])
    points += [
        parts.PointEntry(name, "tie", export.points.get(name, np.full(3, np.nan)) + shift)
        for name in tie
        if name not in control
    ]
    values = np.array([photo.pose for photo in export.photos])
    values[:, 3:] += shift
    sigma = np.full(values.shape, np.inf)
    for name, (xyz, accuracy) in (positions or {}).items():
        if name not in names:
            raise InputMalformedError(f"position of image {name}, which is not in the export", where=place)
        values[names.index(name), 3:] = xyz
        sigma[names.index(name), 3:] = accuracy
    interiors = list(dict.fromkeys(photo.interior for photo in export.photos))
    cameras = tuple(
        _camera(export, interior, f"camera{k}", place) for k, interior in enumerate(interiors, start=1)
    )
    which = [interiors.index(photo.interior) for photo in export.photos]
    return Block(
        export.title or place,
        "local",
        "",
        "control",
        (),
        cameras if own_camera is None else (own_camera,),
        parts.images(names, which if own_camera is None else [0] * len(names), values, sigma),
        parts.object_points(points),
        parts.observations(export.marks, names, [point.name for point in points], "px", "pixel"),
        (export.file,),
    )


def read_photomodeler(export: Path, control: Path | None = None, positions: Path | None = None) -> Block:
    """Read an export with its table of control points."""
    content = read_export(export)
    if control is None and content.control:
        raise ConfigurationError(
            "has control points, whose standard deviations in a PhotoModeler export are a posteriori",
            where=export,
            remedy="put a table id,name,X,Y,Z,sX,sY,sZ beside it as " + control_beside(export).name,
        )
    block = block_from_export(
        content,
        {} if control is None else read_control(control),
        positions=None if positions is None else read_positions(positions),
    )
    tables = tuple(fingerprint(path) for path in (control, positions) if path is not None)
    return replace(block, inputs=block.inputs + tables)


def control_beside(export: Path) -> Path:
    """Where the control points of an export are looked for: `NAME-control.txt` beside it."""
    return export.with_name(f"{export.stem}-control.txt")


def _shift(export: Export, control: dict[str, tuple[Floats, Floats]], place: str) -> Floats:
    """What must be added to exported coordinates: the mean over common control points."""
    common = [name for name in export.control if name in control]
    if not common:
        return np.zeros(3)
    missing = [name for name in export.control if name not in control]
    if missing:
        raise InputMalformedError(
            f"control point {missing[0]} of the export is not in the table of control points", where=place
        )
    return np.asarray(np.mean([control[name][0] - export.control[name] for name in common], axis=0))


def _camera(export: Export, own: tuple[float, ...], name: str, place: str) -> Camera:
    # The photos' c and principal point are printed to 1 um, their coefficients to five decimals; the head has
    # the same values with more digits.
    rounding = [0.51e-3] * 3 + [0.51e-5] * 7
    same = all(abs(a - b) <= most for a, b, most in zip(own, export.interior, rounding, strict=True))
    only = len({photo.interior for photo in export.photos}) == 1
    c, px, py, width, height, k1, k2, k3, p1, p2 = export.interior if same and only else own
    if not (c > 0 and width > 0 and height > 0):
        raise InputMalformedError("principal distance or format is not positive", where=place)
    found = camera(
        name,
        "brown-observed",
        "mm",
        export.size_px,
        (width / export.size_px[0], height / export.size_px[1]),
        {"c": c, "x0": px - width / 2, "y0": height / 2 - py}
        | {"K1": -k1, "K2": -k2, "K3": -k3, "P1": -p1, "P2": -p2},
    )
    return replace(found, distortion_at="measured")


def read_back(folder: Path) -> Reconstruction:
    """A text export with its table of control points."""
    return of_block(read_with_control(folder / "block.txt"))


def read_with_control(path: Path) -> Block:
    """Read a text export with the table of control points that lies beside it."""
    control = control_beside(path)
    return read_photomodeler(path, control if control.exists() else None)
