"""Writing a block as a DBAT set-up with its tables; the conventions are those of `dbat`."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from drivers.arrays import Floats, Integers
from drivers.errors import InputMalformedError
from photocal.block.model import Block, ObjectPoints
from photocal.exchange.choices import Choices
from photocal.exchange.dbat_camera import to_dbat
from photocal.exchange.markup import write_xml
from photocal.exchange.reconstruction import Reconstruction, as_block
from photocal.geometry.camera import PARAMETERS, Camera, plane_to_pixel
from photocal.geometry.conversion import Conversion, unbalanced

CONTROL_FORMAT = "id,x,y,z,sx,sy,sz"
# Switches of DBAT's estimation, and the parameters that each of them frees.
_SWITCHES = {
    "cc": ("c",),
    "pp": ("x0", "y0"),
    "aspect": ("B1",),
    "skew": ("B2",),
    "K": ("K1", "K2", "K3", "K4"),
    "P": ("P1", "P2"),
}


def write_dbat(folder: Path, block: Block) -> Path:
    """Write setup.xml, images.txt, marks.txt, control.txt and check.txt.

    Exterior orientations and tie points are not written: DBAT computes its own start values.
    """
    _require_expressible(block)
    own = unbalanced(block.cameras[0])
    names = block.points.names
    control = np.flatnonzero(block.points.of_role("control"))
    check = np.flatnonzero(block.points.of_role("check"))
    _write(folder / "control.txt", _surveyed(block.points, control))
    _write(folder / "check.txt", _surveyed(block.points, check))
    _write(folder / "images.txt", [[k, name] for k, name in enumerate(block.images.names, start=1)])
    observations = block.observations
    pixels, sigma = _pixels(block, own)
    _write(
        folder / "marks.txt",
        [
            [names[j], int(i) + 1, *(pixel + 0.5).tolist(), *s.tolist()]
            for i, j, pixel, s in zip(observations.image, observations.point, pixels, sigma, strict=True)
        ],
    )
    root = Element("document", dbat_script_version="1.0")
    SubElement(SubElement(root, "meta"), "name").text = block.name
    given = SubElement(root, "input", base_dir="$HERE")
    for section, count in (("ctrl_pts", len(control)), ("check_pts", len(check))):
        if count:
            name = "control.txt" if section == "ctrl_pts" else "check.txt"
            SubElement(SubElement(given, section), "file", format=CONTROL_FORMAT).text = name
    SubElement(SubElement(given, "images"), "file", format="id,path").text = "images.txt"
    SubElement(SubElement(given, "image_pts"), "file", format="id,im,x,y,sx,sy").text = "marks.txt"
    _camera(SubElement(SubElement(given, "cameras"), "camera"), own)
    _operations(SubElement(root, "operations"), own)
    path = folder / "setup.xml"
    write_xml(path, root)
    return path


def lens_model(own: Camera) -> int:
    """Number of DBAT's lens model for a camera."""
    index = [PARAMETERS.index(name) for name in ("B1", "B2")]
    affine = bool(own.values[index].any() or own.estimated[index].any())
    others = [PARAMETERS.index(name) for name in ("P3", "P4")]
    expressible = not (own.values[others].any() or own.estimated[others].any())
    if own.affinity_form != "fraser" and affine:
        expressible = False
    if own.model == "brown-ideal" and not affine and expressible:
        return -1
    if own.model == "brown-observed" and expressible and (not affine or own.affinity != "additive"):
        return 4 if own.affinity == "after" else 3
    raise InputMalformedError(
        f"camera {own.id} has no equivalent in DBAT", remedy="use brown-observed, affinity before or after"
    )


def _require_expressible(block: Block) -> None:
    if len(block.cameras) != 1 or block.cameras[0].unit != "mm":
        raise InputMalformedError("only blocks with one camera, in mm, can be written for DBAT")
    own = block.cameras[0]
    if own.pitch[0] != own.pitch[1]:
        raise InputMalformedError("pixels are not square", remedy="give them square, and the affinity as B1")
    if (
        np.isfinite(own.prior_sigma).any()
        or np.isfinite(block.images.sigma).any()
        or block.relations.kind.size
    ):
        raise InputMalformedError(
            "the block observes orientations or distances, for which a set-up has no place",
            remedy="leave out their sigmas",
        )
    for key, names in _SWITCHES.items():
        held = {bool(own.estimated[PARAMETERS.index(name)]) for name in names[: _count(own, key)]}
        if len(held) > 1:
            raise InputMalformedError(f"DBAT estimates {', '.join(names)} together or not at all")
    for name in block.points.names:
        if not name.isdecimal():
            raise InputMalformedError(f"point {name!r} has no number for a name, as DBAT wants it")


def _count(own: Camera, key: str) -> int:
    """How many parameters of a group the camera has: coefficients end with the last that is used."""
    names = _SWITCHES[key]
    if key not in ("K", "P"):
        return len(names)
    index = [PARAMETERS.index(name) for name in names]
    used = np.flatnonzero((own.values[index] != 0) | own.estimated[index])
    return int(used[-1]) + 1 if len(used) else 0


def _surveyed(points: ObjectPoints, rows: Integers) -> list[list[object]]:
    found: list[list[object]] = []
    for k in rows:
        if not np.isfinite(points.sigma[k]).all() and points.of_role("control")[k]:
            raise InputMalformedError(f"control point {points.names[k]} has coordinates without sigma")
        sigma = np.where(np.isfinite(points.sigma[k]), points.sigma[k], 0.0)
        found.append([points.names[k], *points.values[k].tolist(), *sigma.tolist()])
    return found


def _pixels(block: Block, own: Camera) -> tuple[Floats, Floats]:
    """Column, row and their sigmas in px."""
    observations = block.observations
    scale = 1.0 if observations.unit == "px" else 1 / own.pitch[0]
    if observations.axes == "photo":
        plane = observations.values * scale
        return plane_to_pixel(own.size_px, (1.0, 1.0), plane), observations.sigma * scale
    return observations.values * scale, observations.sigma * scale


def _camera(element: Element, own: Camera) -> None:
    value, _ = to_dbat(own, lens_model(own))
    lists = {key: [value[name] for name in _SWITCHES[key][: _count(own, key)]] for key in ("K", "P")}
    texts = {
        "name": own.id,
        "unit": "mm",
        "sensor": f"auto,{own.size_px[1] * own.pitch[1]!r}",
        "image": f"{own.size_px[0]},{own.size_px[1]}",
        "aspect": repr(1 - value["as"]),
        "focal": repr(value["cc"]),
        "model": str(lens_model(own)),
        "nK": str(len(lists["K"])),
        "nP": str(len(lists["P"])),
        "cc": repr(value["cc"]),
        "pp": f"{value['px']!r},{value['py']!r}",
        "skew": repr(value["sk"]),
    } | {key: ",".join(repr(number) for number in numbers) for key, numbers in lists.items() if numbers}
    for key, text in texts.items():
        SubElement(element, key).text = text


def _operations(element: Element, own: Camera) -> None:
    values = SubElement(SubElement(element, "operation"), "set_initial_values")
    SubElement(values, "io").text = "loaded"
    SubElement(values, "op").text = "loaded"
    estimate = SubElement(SubElement(element, "operation"), "set_bundle_estimate_params")
    switches = SubElement(estimate, "io")
    for key, names in _SWITCHES.items():
        SubElement(switches, key).text = str(bool(own.estimated[PARAMETERS.index(names[0])])).lower()
    SubElement(SubElement(estimate, "eo"), "all").text = "true"
    SubElement(SubElement(estimate, "op"), "all").text = "default"
    for name in ("spatial_resection", "forward_intersection", "bundle_adjustment"):
        SubElement(element, "operation").text = name


def _write(path: Path, rows: list[list[object]]) -> None:
    lines = (", ".join(cell if isinstance(cell, str) else repr(cell) for cell in row) for row in rows)
    path.write_text("".join(line + "\n" for line in lines), encoding="utf-8", newline="\n")


def export(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """A set-up and its tables."""
    write_dbat(folder, as_block(given, given.name, 1.0, ()))
    return tuple(Conversion(own) for own in given.cameras)
