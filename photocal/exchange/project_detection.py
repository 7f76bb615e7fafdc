"""Which program a folder is from, and the whole project that it holds."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.errors import InputNotFoundError, PhotocalError
from photocal.block.model import Block
from photocal.exchange.colmap import FILES as COLMAP_FILES
from photocal.exchange.dbat import read_dbat_cameras
from photocal.exchange.dbat_camera import from_dbat
from photocal.exchange.formats import read_foreign_block
from photocal.exchange.metashape import TERMS, Chunk, local_chunk, read_metashape
from photocal.exchange.micmac import PLACEHOLDER, read_micmac
from photocal.exchange.photoscan import read_project
from photocal.exchange.pix4d_project import CAMERAS, read_pix4d_project
from photocal.exchange.reconstruction import ASSUMED_M, ForeignProject, bare_project
from photocal.exchange.source import numbers, read_xml
from photocal.geometry.camera import Camera

_PROGRAMS = {
    ".psz": ("PhotoScan", True),
    ".psx": ("Metashape", True),
    ".opf": ("OPF", False),
    ".json": ("OpenSfM", False),
    ".txt": ("PhotoModeler", True),
    **dict.fromkeys((".ior", ".eor", ".obc", ".phc"), ("AICON", True)),
}


def read_foreign_project(path: Path) -> ForeignProject:
    """Read a project: a folder, or one of the files that `photocal adjust` takes.

    raises InputNotFoundError: when nothing in it is known.
    raises PhotocalError: for what cannot be read.
    """
    if path.is_file():
        return _of_file(path)
    if not path.is_dir():
        raise InputNotFoundError("does not exist", "name the folder of a project", where=path)
    refusal: PhotocalError | None = None
    for pattern, read in (
        (f"*{CAMERAS}", lambda file: read_pix4d_project(file.parent)),
        ("*.ps[xz]", _of_file),
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
        for file in sorted(path.rglob(pattern), key=lambda candidate: (len(candidate.parts), candidate.name)):
            try:
                return read(file)
            except PhotocalError as failure:
                refusal = refusal or (failure if pattern != "*.txt" else None)
    if refusal is not None:
        raise refusal
    raise InputNotFoundError(
        "holds no project that is known",
        "name a Pix4D params folder, an export of Metashape or PhotoScan, or a folder of ODM, "
        "OpenSfM, COLMAP or MicMac",
        where=path,
    )


def _of_file(path: Path) -> ForeignProject:
    kind = path.suffix.lower()
    program, weighted = _PROGRAMS.get(kind, (path.name, True))
    if kind in (".psz", ".psx"):
        block, chunk = read_project(path)
        return _with_positions(bare_project(program, block, weighted=weighted), chunk)
    block = read_foreign_block(path)
    if path.stem in COLMAP_FILES and kind in (".txt", ".bin"):
        program, weighted = "COLMAP", False
    given = bare_project(program, block, weighted=weighted)
    if kind != ".xml":
        return given
    if read_xml(path).get("dbat_script_version"):
        return replace(given, program="DBAT", cameras=_dbat_results(path, block))
    given = replace(given, program="Metashape", weighted=False, camera_sigma=_metashape_sigmas(path, block))
    return _with_positions(given, local_chunk(read_metashape(path)))


def _with_positions(given: ForeignProject, chunk: Chunk) -> ForeignProject:
    # Positions whose accuracy is not said weigh nothing.
    stated = (chunk.position_sigma > 0).all(axis=1, keepdims=True)
    position, sigma = (np.where(stated, values, np.nan) for values in (chunk.position, chunk.position_sigma))
    return replace(given, position=position, position_sigma=sigma)


def _dbat_results(path: Path, block: Block) -> tuple[Camera, ...]:
    """Cameras that the program wrote below its set-up, by their names."""
    names = {camera.id for camera in block.cameras}
    cameras: dict[str, Camera] = {}
    for file in sorted(path.parent.glob("result*/*.xml")):
        try:
            cameras |= {given.name: from_dbat(given, given.name, file) for given in read_dbat_cameras(file)}
        except PhotocalError:
            continue
    return tuple(camera for name, camera in cameras.items() if name in names)


def _micmac(path: Path) -> ForeignProject:
    tables: dict[str, Path] = {}
    for file in sorted(path.parent.parent.glob("*.xml")):
        tables.setdefault(read_xml(file).tag, file)
    missing = [tag for tag in ("DicoAppuisFlottant", "SetOfMesureAppuisFlottants") if tag not in tables]
    if missing:
        raise InputNotFoundError(f"has no {missing[0]}", "put it there", where=path.parent.parent)
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
    sigmas: dict[str, dict[str, float]] = {}
    for sensor in read_xml(path).iter("sensor"):
        name = sensor.get("label") or sensor.get("id") or "camera"
        camera = next((camera for camera in block.cameras if camera.id == name), None)
        names = (sensor.findtext("covariance/params") or "").split()
        matrix = numbers(sensor.findtext("covariance/coeffs") or "", path, "covariance")
        if camera is None or not names or len(matrix) != len(names) ** 2:
            continue
        sigma = np.sqrt(np.diag(np.reshape(matrix, (len(names), len(names)))))
        c = camera.value("c")
        sigmas[name] = {
            TERMS[key][0]: float(s) / c ** TERMS[key][2]
            for key, s in zip(names, sigma, strict=True)
            if key in TERMS
        }
    return sigmas
