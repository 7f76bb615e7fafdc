"""Writing a MicMac project: calibrations, orientations, ground points, measurements; read by `micmac`.

Ground-Pts3D.xml holds the control points, Check-Pts3D.xml the check points, GroundMeasure.xml every
measurement; the folder Ori-photocal holds the orientations and calibrations (Fraser's model).
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from drivers.arrays import Floats
from photocal.exchange.choices import Choices
from photocal.exchange.markup import write_xml
from photocal.exchange.micmac import CONVENTION, read_micmac
from photocal.exchange.parts import digits, require_file_name
from photocal.exchange.pinhole import to_vision
from photocal.exchange.reconstruction import Reconstruction, of_block
from photocal.geometry.camera import Camera
from photocal.geometry.conversion import Conversion, converted, in_pixels

FOLDER = "Ori-photocal"
TERMS = ("K1", "K2", "K3", "K4", "P1", "P2", "B1", "B2")


def export(folder: Path, given: Reconstruction, _: Choices | None = None) -> tuple[Conversion, ...]:
    """Write a project."""
    for name in (*given.image_names, *(own.id for own in given.cameras)):
        require_file_name(name)
    made = tuple(converted(in_pixels(own), "brown-ideal", "additive", TERMS) for own in given.cameras)
    (folder / FOLDER).mkdir()
    for conversion in made:
        write_xml(folder / FOLDER / _calibration_name(conversion.camera), _calibration(conversion.camera))
    rotation = to_vision(given.poses)[0]
    ground = float(np.nanmedian(given.xyz[:, 2])) if len(given.xyz) else 0.0
    for k, name in enumerate(given.image_names):
        calibration = _calibration_name(given.cameras[given.image_camera[k]])
        root = _orientation(rotation[k].T, given.poses[k, 3:], ground, f"{FOLDER}/{calibration}")
        write_xml(folder / FOLDER / f"Orientation-{name}.xml", root)
    for role, file in (("control", "Ground-Pts3D.xml"), ("check", "Check-Pts3D.xml")):
        chosen = [j for j, own in enumerate(given.roles) if own == role]
        if chosen:
            write_xml(folder / file, _points(given, chosen))
    write_xml(folder / "GroundMeasure.xml", _measures(given))
    return made


def _calibration_name(own: Camera) -> str:
    return f"AutoCal_{own.id}.xml"


def _calibration(own: Camera) -> Element:
    root = Element("ExportAPERO")
    inner = SubElement(root, "CalibrationInternConique")
    width, height = own.size_px
    centre = digits([own.value("x0") + (width - 1) / 2, (height - 1) / 2 - own.value("y0")])
    _leaves(inner, ("KnownConv", CONVENTION), ("PP", centre), ("F", repr(own.value("c"))))
    SubElement(inner, "SzIm").text = f"{width} {height}"
    model = SubElement(SubElement(inner, "CalibDistortion"), "ModPhgrStd")
    radial = SubElement(model, "RadialePart")
    _leaves(radial, ("CDist", centre), *(("CoeffDist", repr(own.value(f"K{n}"))) for n in (1, 2, 3, 4)))
    SubElement(radial, "PPaEqPPs").text = "true"
    # y runs down there: P2 and b2 change their sign.
    terms = {"P1": own.value("P1"), "P2": -own.value("P2"), "b1": own.value("B1"), "b2": -own.value("B2")}
    _leaves(model, *((key, repr(value)) for key, value in terms.items()))
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


def _points(given: Reconstruction, chosen: list[int]) -> Element:
    root = Element("DicoAppuisFlottant")
    for j in chosen:
        sigma = np.nan_to_num(given.xyz_sigma[j]) if len(given.xyz_sigma) else np.zeros(3)
        point = SubElement(root, "OneAppuisDAF")
        _leaves(point, ("Pt", digits(given.xyz[j])), ("NamePt", given.point_names[j]))
        SubElement(point, "Incertitude").text = digits(sigma)
    return root


def _measures(given: Reconstruction) -> Element:
    root = Element("SetOfMesureAppuisFlottants")
    for k, name in enumerate(given.image_names):
        rays = np.flatnonzero(given.image == k)
        if len(rays):
            image = SubElement(root, "MesureAppuiFlottant1Im")
            SubElement(image, "NameIm").text = name
            for ray in rays:
                mark = SubElement(image, "OneMesureAF1I")
                point = given.point_names[given.point[ray]]
                _leaves(mark, ("NamePt", point), ("PtIm", digits(given.pixels[ray])))
    return root


def _leaves(element: Element, *rows: tuple[str, str]) -> None:
    for tag, text in rows:
        SubElement(element, tag).text = text


def read_back(folder: Path) -> Reconstruction:
    """Control points, measurements, orientations and calibrations."""
    return of_block(read_micmac(folder / "Ground-Pts3D.xml", folder / "GroundMeasure.xml", folder / FOLDER))
