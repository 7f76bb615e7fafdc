"""MicMac: ground points, image measurements (saisies), orientations and Tapas calibrations, XML.

Pixels: x right, y down; principal point and measurements refer to the same origin, which the files do not
name: it is taken for the centre of the upper-left pixel, as ours. The distortion is added to the projection
in px (`brown-ideal`, convention DistM2C): radial coefficients of r^2, r^4, ... about the principal point,
and affine and decentering terms of Fraser's model. Orientation as centre and the matrix from camera (x
right, y down, z forward) to object axes, by rows. Source: MicMac documentation, "Conventions", and the
residuals in its own <Verif> tables.
"""

from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import InputMalformedError, InputNotFoundError
from photocal.block.model import Block, Images, ObjectPoints, Role
from photocal.exchange import parts
from photocal.exchange.exporting import Choices
from photocal.exchange.foreign_project import ASSUMED_M, ForeignProject
from photocal.exchange.parts import digits, known, rays_of, require_file_name
from photocal.exchange.pinhole import from_vision, to_vision
from photocal.exchange.source import (
    child,
    image_size,
    number_of,
    numbers,
    read_xml,
    text_of,
    write_xml,
)
from photocal.geometry.camera import Camera, camera
from photocal.geometry.conversion import Conversion, converted, in_pixels

CONVENTION = "eConvApero_DistM2C"
# The uncertainty that the program writes where nobody has given one.
PLACEHOLDER = 1.0
FOLDER, CHECKS = "Ori-photocal", "Check-Pts3D.xml"
TERMS = ("K1", "K2", "K3", "K4", "P1", "P2", "B1", "B2")


def read_calibration(path: Path) -> Camera:
    """Read a calibration (AutoCal_...xml) with radial distortion or Fraser's model."""
    given = child(read_xml(path), "CalibrationInternConique", path)
    _require_convention(given, path)
    place = _vector(given, "PP", path, 2)
    size = _vector(given, "SzIm", path, 2)
    width, height = image_size(size[0], size[1], path)
    values = {
        "c": number_of(given, "F", path),
        "x0": place[0] - (width - 1) / 2,
        "y0": (height - 1) / 2 - place[1],
    }
    models = list(child(given, "CalibDistortion", path))
    if len(models) != 1:
        raise InputMalformedError("has several distortions, one after the other", where=path)
    values |= _distortion(models[0], place, path)
    return camera(path.stem, "brown-ideal", "px", (width, height), (1.0, 1.0), values, affinity="additive")


def read_orientation(path: Path) -> tuple[Floats, str]:
    """Read an orientation (Orientation-IMAGE.xml): omega, phi, kappa, X, Y, Z, and its calibration's file."""
    given = child(read_xml(path), "OrientationConique", path)
    outer = child(given, "Externe", path)
    _require_convention(outer, path)
    axes = np.array([_vector(outer, f"ParamRotation/CodageMatr/L{k}", path, 3) for k in (1, 2, 3)])
    if not np.allclose(axes @ axes.T, np.eye(3), atol=1e-6) or np.linalg.det(axes) < 0:
        raise InputMalformedError("its rotation is not a rotation matrix", where=path)
    centre = np.array(_vector(outer, "Centre", path, 3))
    calibration = text_of(given, "FileInterne", path).replace("\\", "/").rsplit("/", 1)[-1]
    return from_vision(axes.T, -axes.T @ centre), calibration


def read_ground_points(path: Path) -> tuple[parts.PointEntry, ...]:
    """Read ground points (DicoAppuisFlottant, or SetGCP of MMVII)."""
    root = read_xml(path)
    points = []
    for element in root.iter("OneAppuisDAF"):
        sigma = _vector(element, "Incertitude", path, 3)
        points.append(_ground(text_of(element, "NamePt", path), _vector(element, "Pt", path, 3), sigma, path))
    for element in root.iterfind("Data/SetGCP/Measures/el"):
        # xx, xy, xz, yy, yz, zz
        variance = np.array(_vector(element, "__Opt__Sigma2", path, 6))[[0, 3, 5]]
        name = text_of(element, "Name", path).strip('"')
        points.append(_ground(name, _vector(element, "Pt", path, 3), np.sqrt(variance).tolist(), path))
    if not points:
        raise InputMalformedError("has no ground points", "is it the right file?", where=path)
    parts.require_unique([point.name for point in points], "ground point", path)
    return tuple(points)


def read_measures(path: Path) -> tuple[parts.Mark, ...]:
    """Read image measurements (SetOfMesureAppuisFlottants, or SetMesIm of MMVII)."""
    root = read_xml(path)
    marks = []
    for image in root.iter("MesureAppuiFlottant1Im"):
        name = text_of(image, "NameIm", path)
        for element in image.iterfind("OneMesureAF1I"):
            x, y = _vector(element, "PtIm", path, 2)
            marks.append(parts.Mark(name, text_of(element, "NamePt", path), x, y, (1.0, 1.0), path))
    for image in root.iterfind("Data/SetMesIm"):
        name = text_of(image, "NameIm", path).strip('"')
        for element in image.iterfind("Measures/el"):
            x, y = _vector(element, "Pt", path, 2)
            xx, _, yy = _vector(element, "Sigma2", path, 3)
            point = text_of(element, "Name", path).strip('"')
            marks.append(parts.Mark(name, point, x, y, (float(np.sqrt(xx)), float(np.sqrt(yy))), path))
    if not marks:
        raise InputMalformedError("has no image measurements", "is it the right file?", where=path)
    return tuple(marks)


def read(path: Path) -> ForeignProject:
    """Read a project from one of its orientations; control and measurements are next to their folder."""
    folder = path.parent.parent
    tables: dict[str, Path] = {}
    # What we write as check points is nobody's control.
    for file in sorted(folder.glob("*.xml"), key=lambda file: (file.name == CHECKS, file.name)):
        tables.setdefault(read_xml(file).tag, file)
    missing = [tag for tag in ("DicoAppuisFlottant", "SetOfMesureAppuisFlottants") if tag not in tables]
    if missing:
        raise InputNotFoundError(f"has no {missing[0]}", "put it there", where=folder)
    points, measures = (tables[tag] for tag in ("DicoAppuisFlottant", "SetOfMesureAppuisFlottants"))
    checks = folder / CHECKS
    block = read_micmac(points, measures, path.parent, checks if checks.is_file() else None)
    known = np.isfinite(block.points.sigma)
    if not (block.points.sigma[known] == PLACEHOLDER).all():
        return ForeignProject("MicMac", block)
    sigma = np.where(known, ASSUMED_M, block.points.sigma)
    remark = (
        f"all points have the uncertainty {PLACEHOLDER:g}, which looks like a default: {ASSUMED_M} m assumed"
    )
    block = replace(block, points=replace(block.points, sigma=sigma))
    return ForeignProject("MicMac", block, remarks=(remark,))


def read_micmac(points: Path, measures: Path, orientations: Path, checks: Path | None = None) -> Block:
    """Read a MicMac project: control, its measurements, start values, and check points apart."""
    ground = read_ground_points(points)
    if checks not in (None, points):
        ground += tuple(replace(point, role="check") for point in read_ground_points(checks))
    marks = read_measures(measures)
    names = list(dict.fromkeys(mark.image for mark in marks))
    files = {name: orientations / f"Orientation-{name}.xml" for name in names}
    oriented = {name: read_orientation(path) for name, path in files.items() if path.exists()}
    if not oriented:
        raise InputMalformedError("has no orientation of a measured image", where=orientations)
    calibrations = list(dict.fromkeys(name for _, name in oriented.values()))
    cameras = tuple(read_calibration(orientations / name) for name in calibrations)
    used = [mark for mark in marks if mark.image in oriented]
    read = [
        *dict.fromkeys(file for file in (points, checks) if file is not None),
        measures,
        *(files[name] for name in oriented),
        *(orientations / name for name in calibrations),
    ]
    which = [calibrations.index(name) for _, name in oriented.values()]
    shots = Images(tuple(oriented), np.array(which), np.array([pose for pose, _ in oriented.values()]))
    return parts.block_of_marks(points.stem, cameras, shots, ground, used, read)


def _ground(name: str, xyz: list[float], sigma: list[float], path: Path) -> parts.PointEntry:
    if not min(sigma) >= 0:
        raise InputMalformedError(f"the uncertainty of point {name} is negative", where=path)
    return parts.PointEntry(name, "control", xyz, sigma)


def _vector(element: Element, path_in: str, path: Path, count: int) -> list[float]:
    return numbers(text_of(element, path_in, path), path, path_in.rsplit("/", 1)[-1], count)


def _require_convention(element: Element, path: Path) -> None:
    name = text_of(element, "KnownConv", path)
    if name != CONVENTION:
        raise InputMalformedError(f"has the convention {name}", f"convert it to {CONVENTION}", where=path)


def _distortion(given: Element, place: list[float], path: Path) -> dict[str, float]:
    """Our coefficients of a distortion in px about the principal point, whose y runs down."""
    if given.tag == "ModNoDist":
        return {}
    malformed = InputMalformedError.at(path)
    if given.tag not in ("ModRad", "ModPhgrStd"):
        raise malformed(
            f"distortion {given.tag} has no equivalent", "calibrate with RadialStd or FraserBasic"
        )
    radial = given if given.tag == "ModRad" else child(given, "RadialePart", path)
    centre = _vector(radial, "CDist", path, 2)
    if max(abs(a - b) for a, b in zip(centre, place, strict=True)) > 1e-6:
        raise malformed("the distortion has a centre of its own", "calibrate with a common centre (PPaEqPPs)")
    coefficients = [numbers(c.text or "", path, "CoeffDist", 1)[0] for c in radial.iterfind("CoeffDist")]
    if any(coefficients[4:]):
        raise malformed("has more than four radial coefficients")
    values = {f"K{k}": value for k, value in enumerate(coefficients[:4], start=1)}
    if given.tag == "ModPhgrStd":
        p1, p2, b1, b2 = (
            number_of(given, key, path) if given.find(key) is not None else 0.0
            for key in ("P1", "P2", "b1", "b2")
        )
        # dx = P1 (r^2 + 2 x^2) + 2 P2 x y + b1 x + b2 y, with y down.
        values |= {"P1": p1, "P2": -p2, "B1": b1, "B2": -b2}
    return values


def write(folder: Path, given: Block, _: Choices | None = None) -> tuple[Conversion, ...]:
    """Write a project."""
    made = tuple(converted(in_pixels(camera), "brown-ideal", "additive", TERMS) for camera in given.cameras)
    for name in (*given.images.names, *(conversion.camera.id for conversion in made)):
        require_file_name(name)
    (folder / FOLDER).mkdir()
    for conversion in made:
        write_xml(folder / FOLDER / _calibration_name(conversion.camera), _calibration(conversion.camera))
    rotation = to_vision(given.images.values)[0]
    ground = float(np.nanmedian(given.points.values[:, 2])) if len(given.points.values) else 0.0
    for k, name in enumerate(given.images.names):
        calibration = _calibration_name(given.cameras[given.images.camera[k]])
        root = _orientation(rotation[k].T, given.images.values[k, 3:], ground, f"{FOLDER}/{calibration}")
        write_xml(folder / FOLDER / f"Orientation-{name}.xml", root)
    files: tuple[tuple[Role, str], ...] = (("control", "Ground-Pts3D.xml"), ("check", CHECKS))
    for role, file in files:
        chosen = np.flatnonzero(given.points.of_role(role))
        if len(chosen):
            write_xml(folder / file, _points(given.points, chosen))
    write_xml(folder / "GroundMeasure.xml", _measures(given))
    return made


def _calibration_name(camera: Camera) -> str:
    return f"AutoCal_{camera.id}.xml"


def _calibration(camera: Camera) -> Element:
    root = Element("ExportAPERO")
    inner = SubElement(root, "CalibrationInternConique")
    width, height = camera.size_px
    centre = digits([camera.value("x0") + (width - 1) / 2, (height - 1) / 2 - camera.value("y0")])
    _leaves(inner, ("KnownConv", CONVENTION), ("PP", centre), ("F", repr(camera.value("c"))))
    SubElement(inner, "SzIm").text = f"{width} {height}"
    model = SubElement(SubElement(inner, "CalibDistortion"), "ModPhgrStd")
    radial = SubElement(model, "RadialePart")
    _leaves(radial, ("CDist", centre), *(("CoeffDist", repr(camera.value(f"K{n}"))) for n in (1, 2, 3, 4)))
    SubElement(radial, "PPaEqPPs").text = "true"
    # y runs down there: P2 and b2 change their sign.
    for name, sign in (("P1", 1), ("P2", -1), ("B1", 1), ("B2", -1)):
        SubElement(model, name.replace("B", "b")).text = repr(sign * camera.value(name))
    return root


def _orientation(axes: Floats, centre: Floats, ground: float, calibration: str) -> Element:
    root = Element("ExportAPERO")
    given = SubElement(root, "OrientationConique")
    _leaves(SubElement(given, "OrIntImaM2C"), ("I00", "0 0"), ("V10", "1 0"), ("V01", "0 1"))
    _leaves(given, ("TypeProj", "eProjStenope"), ("ZoneUtileInPixel", "true"), ("FileInterne", calibration))
    SubElement(given, "RelativeNameFI").text = "true"
    outer = SubElement(given, "Externe")
    _leaves(outer, ("AltiSol", repr(ground)), ("Profondeur", repr(abs(float(centre[2]) - ground))))
    _leaves(outer, ("KnownConv", CONVENTION), ("Centre", digits(centre)))
    matrix = SubElement(SubElement(outer, "ParamRotation"), "CodageMatr")
    _leaves(matrix, *((f"L{k}", digits(row)) for k, row in enumerate(axes, start=1)))
    return root


def _points(points: ObjectPoints, chosen: Integers) -> Element:
    root = Element("DicoAppuisFlottant")
    for j in chosen:
        point, sigma = SubElement(root, "OneAppuisDAF"), digits(known(points.sigma[j]))
        _leaves(point, ("Pt", digits(points.values[j])), ("NamePt", points.names[j]), ("Incertitude", sigma))
    return root


def _measures(given: Block) -> Element:
    root = Element("SetOfMesureAppuisFlottants")
    rays_of_images = rays_of(given.observations.image, len(given.images.names))
    for name, rays in zip(given.images.names, rays_of_images, strict=True):
        if len(rays):
            image = SubElement(root, "MesureAppuiFlottant1Im")
            SubElement(image, "NameIm").text = name
            for ray in rays:
                mark = SubElement(image, "OneMesureAF1I")
                point = given.points.names[given.observations.point[ray]]
                _leaves(mark, ("NamePt", point), ("PtIm", digits(given.observations.values[ray])))
    return root


def _leaves(element: Element, *rows: tuple[str, str]) -> None:
    for tag, text in rows:
        SubElement(element, tag).text = text
