"""Writing a project in the Open Photogrammetry Format; the conventions are those of `opf`.

What the format wants and an adjustment does not know is filled in and must not be taken for knowledge: the
time of exposure is 1970-01-01, images have three bands of 8 bits, marks have the accuracy 1, the pixels of a
camera in px are 1 um, the shutter is global.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from photocal.exchange.choices import Choices
from photocal.exchange.opf import HALF, LOCAL_CRS, VERSION, format_name
from photocal.exchange.pinhole import Pinhole, require_one_focal_length, to_pinhole
from photocal.exchange.reconstruction import Reconstruction
from photocal.geometry.conversion import Conversion

_SPACE = uuid.uuid5(uuid.NAMESPACE_DNS, "photocal")
_BANDS = (("Red", 0.2126), ("Green", 0.7152), ("Blue", 0.0722))
# Files of the project by the kind of item that they belong to.
_ITEMS: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...] = (
    ("scene_reference_frame", ("scene-reference-frame",), ()),
    ("camera_list", ("camera-list",), ()),
    ("input_cameras", ("input-cameras",), ("camera_list",)),
    ("input_control_points", ("input-control-points",), ("input_cameras",)),
    (
        "projected_control_points",
        ("projected-control-points",),
        ("scene_reference_frame", "input_control_points"),
    ),
    (
        "calibration",
        ("calibrated-cameras", "calibrated-control-points"),
        ("scene_reference_frame", "input_cameras", "input_control_points"),
    ),
)


def export(folder: Path, given: Reconstruction, _: Choices | None = None) -> tuple[Conversion, ...]:
    """Write project.opf and the files that it names."""
    made = [to_pinhole(own, "OPF") for own in given.cameras]
    pinholes = [pinhole for pinhole, _ in made]
    for own, pinhole in zip(given.cameras, pinholes, strict=True):
        require_one_focal_length(pinhole, own.id, "an OPF project")
    contents = {
        "scene-reference-frame": _frame(),
        "camera-list": {"cameras": [{"id": k, "uri": quote(name)} for k, name in _images(given)]},
        "input-cameras": {"sensors": _sensors(given, pinholes), "captures": _captures(given)},
        "input-control-points": _input_points(given),
        "projected-control-points": {"projected_gcps": _projected(given)},
        "calibrated-cameras": _calibrated(given, pinholes),
        "calibrated-control-points": {
            "points": [
                {"id": name, "coordinates": xyz}
                for name, xyz in zip(given.point_names, given.xyz.tolist(), strict=True)
            ]
        },
    }
    for kind, content in contents.items():
        _write(folder / _file(kind), {"format": format_name(kind), "version": VERSION, **content})
    _write(folder / "project.opf", _project(given))
    return tuple(conversion for _, conversion in made)


def _project(given: Reconstruction) -> dict[str, Any]:
    ids = {kind: str(uuid.uuid5(_SPACE, f"{given.name}/{kind}")) for kind, _, _ in _ITEMS}
    items = [
        {
            "id": ids[kind],
            "name": kind.replace("_", " "),
            "type": kind,
            "resources": [{"format": format_name(part), "uri": _file(part)} for part in files],
            "sources": [{"id": ids[source], "type": source} for source in sources],
        }
        for kind, files, sources in _ITEMS
    ]
    return {
        "format": format_name("project"),
        "version": VERSION,
        "id": str(uuid.uuid5(_SPACE, given.name)),
        "name": given.name,
        "description": "",
        "items": items,
    }


def _frame() -> dict[str, Any]:
    same = {"scale": [1.0, 1.0, 1.0], "shift": [0.0, 0.0, 0.0], "swap_xy": False}
    return {"crs": {"definition": LOCAL_CRS}, "base_to_canonical": same}


def _images(given: Reconstruction) -> Iterable[tuple[int, str]]:
    return enumerate(given.image_names, start=1)


def _sensor_id(given: Reconstruction, k: int) -> int:
    """Sensors are numbered behind the images."""
    return len(given.image_names) + 1 + k


def _internals(pinhole: Pinhole) -> dict[str, Any]:
    return {
        "type": "perspective",
        "principal_point_px": [pinhole.cx + HALF, pinhole.cy + HALF],
        "focal_length_px": pinhole.fy,
        "radial_distortion": [pinhole.k1, pinhole.k2, pinhole.k3],
        "tangential_distortion": [pinhole.p1, pinhole.p2],
    }


def _sensors(given: Reconstruction, pinholes: list[Pinhole]) -> list[dict[str, Any]]:
    return [
        {
            "id": _sensor_id(given, k),
            "name": own.id,
            "bands": [{"name": name, "weight": weight} for name, weight in _BANDS],
            "image_size_px": list(own.size_px),
            "internals": _internals(pinhole),
            "pixel_size_um": own.pitch[0] * 1e3 if own.unit == "mm" else 1.0,
            "shutter_type": "global",
        }
        for k, (own, pinhole) in enumerate(zip(given.cameras, pinholes, strict=True))
    ]


def _captures(given: Reconstruction) -> list[dict[str, Any]]:
    first = _sensor_id(given, len(given.cameras))
    return [
        {
            "id": first + k,
            "reference_camera_id": k,
            "rig_model_source": "not_applicable",
            "time": "1970-01-01T00:00:00",
            "cameras": [
                {
                    "id": k,
                    "sensor_id": _sensor_id(given, int(given.image_camera[k - 1])),
                    "model_source": "user",
                    "pixel_range": {"min": 0, "max": 255},
                    "pixel_type": "uint8",
                }
            ],
        }
        for k, _ in _images(given)
    ]


def _input_points(given: Reconstruction) -> dict[str, Any]:
    roles = given.roles or ("tie",) * len(given.point_names)
    order = np.argsort(given.point, kind="stable")
    bounds = np.searchsorted(given.point[order], np.arange(len(given.point_names) + 1))
    surveyed, others = [], []
    for j, (name, role) in enumerate(zip(given.point_names, roles, strict=True)):
        rays = order[bounds[j] : bounds[j + 1]]
        marks = [
            {"camera_id": int(given.image[ray]) + 1, "position_px": pixel, "accuracy": 1.0}
            for ray, pixel in zip(rays, (given.pixels[rays] + HALF).tolist(), strict=True)
        ]
        point = {"id": name, "marks": marks, "is_checkpoint": role == "check"}
        if role == "tie":
            others.append(point)
        else:
            surveyed.append({**point, "geolocation": {"crs": {"definition": LOCAL_CRS}, **_place(given, j)}})
    return {"gcps": surveyed, "mtps": others}


def _projected(given: Reconstruction) -> list[dict[str, Any]]:
    surveyed = [j for j, role in enumerate(given.roles) if role != "tie"]
    return [{"id": given.point_names[j], **_place(given, j)} for j in surveyed]


def _place(given: Reconstruction, j: int) -> dict[str, list[float]]:
    """Coordinates and standard deviations; a sigma that is not known is 0."""
    sigma = given.xyz_sigma[j] if len(given.xyz_sigma) else np.zeros(3)
    return {"coordinates": given.xyz[j].tolist(), "sigmas": np.nan_to_num(sigma).tolist()}


def _calibrated(given: Reconstruction, pinholes: list[Pinhole]) -> dict[str, Any]:
    angles = np.degrees(given.poses[:, :3]).tolist()
    cameras = [
        {"id": k + 1, "sensor_id": _sensor_id(given, own), "orientation_deg": angles[k], "position": place}
        for k, (own, place) in enumerate(
            zip(given.image_camera.tolist(), given.poses[:, 3:].tolist(), strict=True)
        )
    ]
    sensors = [
        {"id": _sensor_id(given, k), "internals": _internals(pinhole)} for k, pinhole in enumerate(pinholes)
    ]
    return {"sensors": sensors, "cameras": cameras}


def _file(kind: str) -> str:
    return kind.replace("-", "_") + ".json"


def _write(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8", newline="\n")
