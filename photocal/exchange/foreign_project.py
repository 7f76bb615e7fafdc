"""A whole project of another program: its block as it was measured, and what the program says of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputNotFoundError, PhotocalError
from photocal.block.model import ROLES, Block, Observations
from photocal.exchange.format_detection import read_foreign_block
from photocal.exchange.models import COLMAP_FILES
from photocal.exchange.reconstruction import of_block
from photocal.geometry.camera import Camera

Floats = NDArray[np.float64]
# Sigmas of control points that nobody has given, X, Y, Z, m.
ASSUMED_M = (0.02, 0.02, 0.03)
# Affinities below are what a quotient of equal focal lengths leaves.
_NOTHING = 1e-9
_PROGRAMS = {
    ".psz": ("PhotoScan", True),
    ".opf": ("OPF", False),
    ".json": ("OpenSfM", False),
    ".txt": ("PhotoModeler", True),
    **dict.fromkeys((".ior", ".eor", ".obc", ".phc"), ("AICON", True)),
}


@dataclass(frozen=True)
class ForeignProject:
    """What was read.

    Attributes
    ----------
    program : str
    block : Block
        Observations in px; cameras and orientations are the program's results, control is as surveyed.
    position : ndarray, shape (images, 3)
        Observed by GNSS, in the block's frame; NaN without.
    position_sigma : ndarray, shape (images, 3)
        As typed or stated; NaN without.
    pose_sigma : ndarray, shape (images, 6)
        That the program promises (rad, m); NaN without.
    adjusted : dict of str to ndarray, shape (3,)
        Coordinates of control and check points as the program adjusted them.
    cameras : tuple of Camera
        As the program adjusted them, where the block has its start values; else empty.
    camera_sigma : dict of str to dict of str to float
        That the program promises, by camera and parameter.
    remarks : tuple of str
        What was assumed or left out.
    weighted : bool
        Whether the program states sigmas of image coordinates.
    """

    program: str
    block: Block
    position: Floats
    position_sigma: Floats
    pose_sigma: Floats
    adjusted: dict[str, Floats] = field(default_factory=dict)
    cameras: tuple[Camera, ...] = ()
    camera_sigma: dict[str, dict[str, float]] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    weighted: bool = False


def bare_project(program: str, block: Block, *, weighted: bool) -> ForeignProject:
    """Take a block of which the program says nothing more."""
    none = np.full((len(block.images.names), 6), np.nan)
    return ForeignProject(program, in_pixels(block), none[:, :3], none[:, :3], none, weighted=weighted)


def in_pixels(block: Block) -> Block:
    """Give a block's observations in px of the stored grid, with their sigmas."""
    seen = block.observations
    if (seen.unit, seen.axes) == ("px", "pixel"):
        return block
    pitch = np.array([own.pitch for own in block.cameras])[block.images.camera[seen.image]]
    sigma = seen.sigma / pitch if seen.unit == "mm" else seen.sigma
    values = of_block(block).pixels
    return replace(block, observations=Observations("px", "pixel", seen.image, seen.point, values, sigma))


def read_foreign_project(path: Path) -> ForeignProject:
    """Read a project: a folder, or one of the files that `photocal adjust` takes.

    Raises
    ------
    InputNotFoundError
        When nothing in it is known.
    PhotocalError
        For what cannot be read.
    """
    if path.is_file():
        return _of_file(path)
    if not path.is_dir():
        raise InputNotFoundError("does not exist", where=path, remedy="name the folder of a project")
    from photocal.exchange.pix4d_project import CAMERAS, read_pix4d_project

    refusal: PhotocalError | None = None
    for pattern, read in (
        (f"*{CAMERAS}", lambda found: read_pix4d_project(found.parent)),
        ("*.psz", _of_file),
        ("project.opf", _of_file),
        ("*.opf", _of_file),
        ("cameras.bin", _of_file),
        ("cameras.txt", _of_file),
        ("reconstruction*.json", _of_file),
        ("Ori-*/Orientation-*.xml", _micmac),
        ("*.ior", _of_file),
        ("*.xml", _of_file),
        ("*.txt", _of_file),
    ):
        # What lies least deep is the project, what lies deeper its parts.
        for found in sorted(path.rglob(pattern), key=lambda one: (len(one.parts), one.name)):
            try:
                return read(found)
            except PhotocalError as failure:
                refusal = refusal or (failure if pattern != "*.txt" else None)
    if refusal is not None:
        raise refusal
    raise InputNotFoundError(
        "holds no project that is known",
        where=path,
        remedy="name a Pix4D params folder, an export of Metashape or PhotoScan, or a folder of ODM, "
        "OpenSfM, COLMAP or MicMac",
    )


def _of_file(path: Path) -> ForeignProject:
    block = read_foreign_block(path)
    kind = path.suffix.lower()
    program, weighted = _PROGRAMS.get(kind, (path.name, True))
    if path.stem in COLMAP_FILES and kind in (".txt", ".bin"):
        program, weighted = "COLMAP", False
    given = bare_project(program, block, weighted=weighted)
    if kind != ".xml":
        return given
    from photocal.exchange.markup import read_xml

    if read_xml(path).get("dbat_script_version"):
        return replace(given, program="DBAT", cameras=_dbat_results(path, block))
    return replace(given, program="Metashape", weighted=False, camera_sigma=_metashape_sigmas(path, block))


def _dbat_results(path: Path, block: Block) -> tuple[Camera, ...]:
    """Cameras that the program wrote below its set-up, by their names."""
    from photocal.exchange.dbat import read_dbat_cameras
    from photocal.exchange.dbat_camera import from_dbat

    names = {own.id for own in block.cameras}
    found: dict[str, Camera] = {}
    for one in sorted(path.parent.glob("result*/*.xml")):
        try:
            found |= {own.name: from_dbat(own, own.name, one) for own in read_dbat_cameras(one)}
        except PhotocalError:
            continue
    return tuple(own for name, own in found.items() if name in names)


def _micmac(path: Path) -> ForeignProject:
    from photocal.exchange.markup import read_xml
    from photocal.exchange.micmac import PLACEHOLDER, read_micmac

    tables: dict[str, Path] = {}
    for one in sorted(path.parent.parent.glob("*.xml")):
        tables.setdefault(read_xml(one).tag, one)
    missing = [tag for tag in ("DicoAppuisFlottant", "SetOfMesureAppuisFlottants") if tag not in tables]
    if missing:
        raise InputNotFoundError(f"has no {missing[0]}", where=path.parent.parent, remedy="put it there")
    points, measures = (tables[tag] for tag in ("DicoAppuisFlottant", "SetOfMesureAppuisFlottants"))
    given = bare_project("MicMac", read_micmac(points, measures, path.parent), weighted=False)
    sigma = given.block.points.sigma
    if not (sigma[np.isfinite(sigma)] == PLACEHOLDER).all():
        return given
    sigma = np.where(np.isfinite(sigma), ASSUMED_M, sigma)
    block = replace(given.block, points=replace(given.block.points, sigma=sigma))
    remark = (
        f"all points have the uncertainty {PLACEHOLDER:g}, as if nobody had given one: {ASSUMED_M} m assumed"
    )
    return replace(given, block=block, remarks=(remark,))


def _metashape_sigmas(path: Path, block: Block) -> dict[str, dict[str, float]]:
    """Standard deviations of the adjusted calibration, where the XML has their covariance."""
    from photocal.exchange.markup import read_xml

    found: dict[str, dict[str, float]] = {}
    power = {"k1": ("K1", 2), "k2": ("K2", 4), "k3": ("K3", 6), "k4": ("K4", 8), "p1": ("P1", 1)}
    power |= {
        "f": ("c", 0),
        "cx": ("x0", 0),
        "cy": ("y0", 0),
        "p2": ("P2", 1),
        "b1": ("B1", 1),
        "b2": ("B2", 1),
    }
    for sensor in read_xml(path).iter("sensor"):
        name = sensor.get("label") or sensor.get("id") or "camera"
        own = next((one for one in block.cameras if one.id == name), None)
        names = (sensor.findtext("covariance/params") or "").split()
        matrix = [float(cell) for cell in (sensor.findtext("covariance/coeffs") or "").split()]
        if own is None or not names or len(matrix) != len(names) ** 2:
            continue
        sigma = np.sqrt(np.diag(np.reshape(matrix, (len(names), len(names)))))
        c = own.value("c")
        found[name] = {
            power[key][0]: float(s) / c ** power[key][1]
            for key, s in zip(names, sigma, strict=True)
            if key in power
        }
    return found


def estimating_what_it_has(block: Block, *, weighted: bool) -> Block:
    """Estimate what the program's camera has that is not zero; with set-ups what they say is estimated."""
    from photocal.geometry.camera import PARAMETERS

    rest = np.where([name in ("B1", "B2") for name in PARAMETERS], _NOTHING, 0.0)
    cameras = tuple(
        own if weighted and own.estimated.any() else replace(own, estimated=np.abs(own.values) > rest)
        for own in block.cameras
    )
    return replace(block, cameras=cameras)


def without_weak_points(block: Block) -> tuple[Block, int]:
    """Leave out tie and check points with one ray; control may have one."""
    rays = np.bincount(block.observations.point, minlength=len(block.points.names))
    keep = (rays >= 2) | ((block.points.role == ROLES.index("control")) & (rays >= 1))
    number = np.where(keep, np.cumsum(keep) - 1, -1)
    seen, points = block.observations, block.points
    left = keep[seen.point]
    return replace(
        block,
        points=replace(
            points,
            names=tuple(name for name, stays in zip(points.names, keep, strict=True) if stays),
            values=points.values[keep],
            sigma=points.sigma[keep],
            role=points.role[keep],
            cross=None if points.cross is None else points.cross[keep],
        ),
        observations=replace(
            seen,
            image=seen.image[left],
            point=number[seen.point[left]],
            values=seen.values[left],
            sigma=seen.sigma[left],
        ),
    ), int((~keep).sum())
