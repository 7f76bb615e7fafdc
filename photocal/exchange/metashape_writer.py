"""Writing a camera XML of Metashape; the conventions are those of `metashape`."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from photocal.exchange.choices import Choices
from photocal.exchange.markup import write_xml
from photocal.exchange.pinhole import to_vision
from photocal.exchange.reconstruction import Reconstruction
from photocal.geometry.camera import Camera
from photocal.geometry.conversion import Conversion, converted, in_pixels


def write_metashape(path: Path, given: Reconstruction) -> tuple[Conversion, ...]:
    """Write a camera XML in local coordinates, with the control and check points as markers."""
    root = Element("document", version="1.5.0")
    chunk = SubElement(root, "chunk", label="photocal", enabled="true")
    sensors = SubElement(chunk, "sensors", next_id=str(len(given.cameras)))
    made = []
    for k, own in enumerate(given.cameras):
        conversion = to_metashape(own)
        made.append(conversion)
        sensor = SubElement(sensors, "sensor", id=str(k), label=own.id, type="frame")
        width, height = (str(side) for side in own.size_px)
        SubElement(sensor, "resolution", width=width, height=height)
        calibration = SubElement(sensor, "calibration", {"type": "frame", "class": "adjusted"})
        SubElement(calibration, "resolution", width=width, height=height)
        for key, value in _frame(conversion.camera).items():
            if value or key in ("f", "cx", "cy"):
                SubElement(calibration, key).text = repr(value)
    rotation, translation = to_vision(given.poses)
    shots = SubElement(chunk, "cameras", next_id=str(len(given.image_names)))
    for k, name in enumerate(given.image_names):
        matrix = np.eye(4)
        matrix[:3, :3] = rotation[k].T
        matrix[:3, 3] = -rotation[k].T @ translation[k]
        shot = SubElement(
            shots, "camera", id=str(k), sensor_id=str(given.image_camera[k]), label=name, enabled="true"
        )
        SubElement(shot, "transform").text = " ".join(repr(value) for value in matrix.ravel().tolist())
    _write_markers(chunk, given)
    crs = 'LOCAL_CS["Local Coordinates (m)",LOCAL_DATUM["Local Datum",0],UNIT["metre",1]]'
    SubElement(chunk, "reference").text = crs
    write_xml(path, root)
    return tuple(made)


def to_metashape(own: Camera) -> Conversion:
    """Express a camera in Metashape's model, still with our signs, in px."""
    flat = in_pixels(own)
    terms = ["K1", "K2", "K3", "K4", "P1", "P2"]
    if flat.value("B1") or flat.value("B2"):
        terms += ["B1", "B2"]
    if own.model == "brown-ideal":
        # In a fit P3 and P4 would stand on P1 and P2, which are nearly zero.
        terms += ["P3", "P4"]
    return converted(flat, "brown-ideal", "after", terms)


def _frame(own: Camera) -> dict[str, float]:
    """Metashape's keys of a camera in its model."""
    f = own.value("c")
    return {
        "f": f,
        "cx": own.value("x0"),
        "cy": -own.value("y0"),
        "b1": own.value("B1") * f,
        "b2": -own.value("B2") * f,
        **{f"k{n}": own.value(f"K{n}") * f ** (2 * n) for n in (1, 2, 3, 4)},
        "p1": own.value("P1") * f,
        "p2": -own.value("P2") * f,
        "p3": own.value("P3") * f**2,
        "p4": own.value("P4") * f**4,
    }


def _write_markers(chunk: Element, given: Reconstruction) -> None:
    surveyed = [k for k, role in enumerate(given.roles) if role != "tie"]
    if not surveyed:
        return
    markers = SubElement(chunk, "markers", next_id=str(len(surveyed)))
    frame = SubElement(SubElement(chunk, "frames"), "frame", id="0")
    seen = SubElement(frame, "markers")
    for key, k in enumerate(surveyed):
        marker = SubElement(markers, "marker", id=str(key), label=given.point_names[k])
        xyz = {axis: repr(value) for axis, value in zip("xyz", given.xyz[k].tolist(), strict=True)}
        if len(given.xyz_sigma) and np.isfinite(given.xyz_sigma[k]).all():
            xyz |= {f"s{axis}": repr(s) for axis, s in zip("xyz", given.xyz_sigma[k].tolist(), strict=True)}
        SubElement(marker, "reference", {**xyz, "enabled": str(given.roles[k] == "control").lower()})
        rays = SubElement(seen, "marker", marker_id=str(key))
        for ray in np.flatnonzero(given.point == k):
            x, y = (given.pixels[ray] + 0.5).tolist()
            SubElement(rays, "location", camera_id=str(given.image[ray]), pinned="true", x=repr(x), y=repr(y))


def export(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """A camera XML."""
    return write_metashape(folder / "cameras.xml", given)
