"""Open Photogrammetry Format (OPF 1.0): a project file, and JSON files for cameras and control points.

Pixels: x right, y down, (0, 0) is the upper-left corner of the upper-left pixel for marks and principal
points, half a pixel more than ours. The distortion is added to the normalised projection (`brown-ideal`):
radial R1 to R3 and tangential T1, T2 as k1, k2, k3, p1, p2 of OpenCV, with one focal length in px. Camera
axes x right, y up, z backwards and omega, phi, kappa (deg) as ours. Object space: the project's processing
frame, Cartesian, whose shift against the reference system stands in the file and is left alone. Every point
is a control point here: surveyed ones "gcps", others "mtps" (manual tie points) with calibrated
coordinates; tie points of a glTF point cloud are not read. Source: OPF specification, "Calibrated cameras",
"Control points".
"""

import uuid
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import InputMalformedError
from photocal.base.files import write_json
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Role
from photocal.exchange.exporting import Choices
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.parts import block, known, listed_pixels, rays_of, require_unique
from photocal.exchange.pinhole import LARGEST, Pinhole, from_pinhole, require_one_focal_length, to_pinhole
from photocal.exchange.source import beside, image_size, read_json, structured
from photocal.geometry.camera import Camera
from photocal.geometry.conversion import Conversion

VERSION = "1.0"
HALF = 0.5
LOCAL_CRS = (
    'ENGCRS["Local Cartesian frame",EDATUM["Origin of the block"],CS[Cartesian,3],AXIS["easting (X)",east,'
    'ORDER[1]],AXIS["northing (Y)",north,ORDER[2]],AXIS["up (Z)",up,ORDER[3]],LENGTHUNIT["metre",1.0]]'
)
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


def format_name(kind: str) -> str:
    """Name of a resource format, for example `application/opf-camera-list+json`."""
    return f"application/opf-{kind}+json"


def read(path: Path) -> ForeignProject:
    """Read a calibrated project."""
    given = structured(path, "an OPF project", lambda: _read(path))
    return ForeignProject("OPF", given, normalised=True)


def _read(path: Path) -> Block:
    resources = _resources(path)
    inputs, calibrated = _load(resources, "input-cameras"), _load(resources, "calibrated-cameras")
    where = resources["calibrated-cameras"]
    cameras = dict(_cameras(inputs, calibrated, where))
    uris = {int(row["id"]): unquote(row["uri"]) for row in _load(resources, "camera-list")["cameras"]}
    files = {key: uri.replace("\\", "/").rsplit("/", 1)[-1] for key, uri in uris.items()}
    shots = calibrated["cameras"]
    lost = [int(shot["id"]) for shot in shots if int(shot["id"]) not in files]
    strange = [int(shot["sensor_id"]) for shot in shots if int(shot["sensor_id"]) not in cameras]
    if lost or strange:
        what = f"camera {lost[0]}, which is not in the camera list" if lost else f"sensor {strange[0]}"
        raise InputMalformedError(f"has the unknown {what}", where=where)
    rolling = [files[int(shot["id"])] for shot in shots if any(shot.get("rolling_shutter") or ())]
    if rolling:
        raise InputMalformedError(
            f"image {rolling[0]} has a rolling shutter, for which there is no equivalent",
            "calibrate with a global shutter",
            where=where,
        )
    names = tuple(files[int(shot["id"])] for shot in shots)
    require_unique(names, "image", path)
    order = {key: k for k, key in enumerate(cameras)}
    points, roles, rays = _control_points(resources, {int(shot["id"]): k for k, shot in enumerate(shots)})
    xyz, sigma = _coordinates(resources, points)
    poses = np.hstack(
        [
            np.radians(_triples([shot["orientation_deg"] for shot in shots])),
            _triples([shot["position"] for shot in shots]),
        ]
    )
    if not max(np.abs(poses).max(initial=0), np.abs(np.nan_to_num(xyz)).max(initial=0)) < LARGEST:
        raise InputMalformedError("has coordinates beyond 1e9 m", "is it damaged?", where=path)
    which = np.array([order[int(shot["sensor_id"])] for shot in shots], dtype=np.int64)
    role = np.array([ROLES.index(word) for word in roles], dtype=np.int64)
    return block(
        str(read_json(path)["name"]),
        tuple(cameras.values()),
        Images(names, which, poses),
        ObjectPoints(points, xyz, sigma, role),
        listed_pixels(rays, -HALF),
        list(resources.values()),
    )


def _resources(path: Path) -> dict[str, Path]:
    """Find the files that a project names, by their kind; its own stands among them."""
    project = read_json(path)
    if project["format"] != format_name("project"):
        raise InputMalformedError("is not an OPF project", "name the file project.opf", where=path)
    _require_version(project, path)
    files = {"project": path}
    for item in project["items"]:
        for resource in item["resources"]:
            kind = resource["format"].removeprefix("application/opf-").removesuffix("+json")
            if format_name(kind) == resource["format"] and kind not in files:
                files[kind] = beside(path.parent, unquote(resource["uri"]), path)
    return files


def _load(files: dict[str, Path], kind: str) -> dict[str, Any]:
    """Read the file of a kind that the project names."""
    if kind not in files:
        raise InputMalformedError(
            f"names no {kind.replace('-', ' ')}", "export a calibrated project", where=files["project"]
        )
    content: dict[str, Any] = read_json(files[kind])
    if content["format"] != format_name(kind):
        raise InputMalformedError(f"is {content['format']!r}, not {format_name(kind)!r}", where=files[kind])
    _require_version(content, files[kind])
    return content


def _require_version(content: dict[str, Any], path: Path) -> None:
    if str(content["version"]).split(".")[0] != VERSION.split(".")[0]:
        raise InputMalformedError(
            f"has version {content['version']}", f"export version {VERSION}", where=path
        )


def _cameras(inputs: dict[str, Any], calibrated: dict[str, Any], path: Path) -> Iterator[tuple[int, Camera]]:
    known = {int(sensor["id"]): sensor for sensor in inputs["sensors"]}
    for sensor in calibrated["sensors"]:
        key = int(sensor["id"])
        malformed = InputMalformedError.at(path)
        if key not in known:
            raise malformed(f"sensor {key} is not among the input cameras")
        width, height = known[key]["image_size_px"]
        given = sensor["internals"]
        if given["type"] != "perspective":
            raise malformed(f"sensor {known[key]['name']} is {given['type']!r}, which has no equivalent")
        f = float(given["focal_length_px"])
        cx, cy = given["principal_point_px"]
        k1, k2, k3 = given["radial_distortion"]
        p1, p2 = given["tangential_distortion"]
        size = image_size(float(width), float(height), path)
        pinhole = Pinhole(size, f, f, float(cx) - HALF, float(cy) - HALF, k1, k2, k3, p1, p2)
        yield key, from_pinhole(pinhole, str(known[key]["name"]) or str(key), path)


def _control_points(
    resources: dict[str, Path], images: dict[int, int]
) -> tuple[tuple[str, ...], tuple[Role, ...], list[tuple[int, int, float, float]]]:
    """Names and roles of the control points, and where they are seen."""
    if "input-control-points" not in resources:
        return (), (), []
    given = _load(resources, "input-control-points")
    points: list[tuple[dict[str, Any], Role]] = [
        (point, "check" if point["is_checkpoint"] else "control") for point in given["gcps"]
    ]
    points += [(point, "tie") for point in given["mtps"]]
    names = tuple(str(point["id"]) for point, _ in points)
    require_unique(names, "control point", resources["input-control-points"])
    rays = []
    for j, (point, _) in enumerate(points):
        for mark in point["marks"]:
            x, y = mark["position_px"]
            if int(mark["camera_id"]) in images:
                rays.append((images[int(mark["camera_id"])], j, float(x), float(y)))
    return names, tuple(role for _, role in points), rays


def _coordinates(resources: dict[str, Path], names: tuple[str, ...]) -> tuple[Floats, Floats]:
    """Coordinates, calibrated before surveyed, and standard deviations; NaN when not given."""
    position = {name: j for j, name in enumerate(names)}
    xyz, sigma = np.full((len(names), 3), np.nan), np.full((len(names), 3), np.nan)
    for kind, key in (
        ("projected-control-points", "projected_gcps"),
        ("calibrated-control-points", "points"),
    ):
        rows = _load(resources, kind)[key] if kind in resources else []
        rows = [row for row in rows if row["id"] in position]
        index = [position[row["id"]] for row in rows]
        xyz[index] = _triples([row["coordinates"] for row in rows])
        if key == "projected_gcps":
            sigma[index] = _triples([row["sigmas"] for row in rows])
    return xyz, sigma


def _triples(rows: list[Any]) -> Floats:
    return np.array([[float(value) for value in row] for row in rows], dtype=float).reshape(-1, 3)


def write(folder: Path, given: Block, _: Choices | None = None) -> tuple[Conversion, ...]:
    """Write project.opf and the files that it names."""
    made = [to_pinhole(camera, "OPF") for camera in given.cameras]
    pinholes = [pinhole for pinhole, _ in made]
    for camera, pinhole in zip(given.cameras, pinholes, strict=True):
        require_one_focal_length(pinhole, camera.id, "an OPF project")
    contents: dict[str, dict[str, Any]] = {
        "scene-reference-frame": {
            "crs": {"definition": LOCAL_CRS},
            "base_to_canonical": {"scale": [1.0, 1.0, 1.0], "shift": [0.0, 0.0, 0.0], "swap_xy": False},
        },
        "camera-list": {"cameras": [{"id": k, "uri": quote(name)} for k, name in _images(given)]},
        "input-cameras": {"sensors": _sensors(given, pinholes), "captures": _captures(given)},
        "input-control-points": _input_points(given),
        "projected-control-points": {
            "projected_gcps": [
                {"id": given.points.names[j], **_place(given.points, j)}
                for j in np.flatnonzero(~given.points.of_role("tie")).tolist()
            ]
        },
        "calibrated-cameras": _calibrated(given, pinholes),
        "calibrated-control-points": {
            "points": [
                {"id": name, "coordinates": xyz}
                for name, xyz in zip(given.points.names, given.points.values.tolist(), strict=True)
            ]
        },
    }
    for kind, content in contents.items():
        write_json(folder / _file(kind), {"format": format_name(kind), "version": VERSION, **content})
    write_json(folder / "project.opf", _project(given))
    return tuple(conversion for _, conversion in made)


def _project(given: Block) -> dict[str, Any]:
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


def _images(given: Block) -> Iterable[tuple[int, str]]:
    return enumerate(given.images.names, start=1)


def _sensor_id(given: Block, k: int) -> int:
    """Sensors are numbered behind the images."""
    return len(given.images.names) + 1 + k


def _internals(pinhole: Pinhole) -> dict[str, Any]:
    return {
        "type": "perspective",
        "principal_point_px": [pinhole.cx + HALF, pinhole.cy + HALF],
        "focal_length_px": pinhole.fy,
        "radial_distortion": [pinhole.k1, pinhole.k2, pinhole.k3],
        "tangential_distortion": [pinhole.p1, pinhole.p2],
    }


def _sensors(given: Block, pinholes: list[Pinhole]) -> list[dict[str, Any]]:
    return [
        {
            "id": _sensor_id(given, k),
            "name": camera.id,
            "bands": [{"name": name, "weight": weight} for name, weight in _BANDS],
            "image_size_px": list(camera.size_px),
            "internals": _internals(pinhole),
            "pixel_size_um": camera.pitch[0] * 1e3 if camera.unit == "mm" else 1.0,
            "shutter_type": "global",
        }
        for k, (camera, pinhole) in enumerate(zip(given.cameras, pinholes, strict=True))
    ]


def _captures(given: Block) -> list[dict[str, Any]]:
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
                    "sensor_id": _sensor_id(given, int(given.images.camera[k - 1])),
                    "model_source": "user",
                    "pixel_range": {"min": 0, "max": 255},
                    "pixel_type": "uint8",
                }
            ],
        }
        for k, _ in _images(given)
    ]


def _input_points(given: Block) -> dict[str, Any]:
    points, seen = given.points, given.observations
    surveyed, others = [], []
    for j, rays in enumerate(rays_of(seen.point, len(points.names))):
        marks = [
            {"camera_id": int(seen.image[ray]) + 1, "position_px": pixel, "accuracy": 1.0}
            for ray, pixel in zip(rays, (seen.values[rays] + HALF).tolist(), strict=True)
        ]
        role = ROLES[points.role[j]]
        point = {"id": points.names[j], "marks": marks, "is_checkpoint": role == "check"}
        if role == "tie":
            others.append(point)
        else:
            surveyed.append({**point, "geolocation": {"crs": {"definition": LOCAL_CRS}, **_place(points, j)}})
    return {"gcps": surveyed, "mtps": others}


def _place(points: ObjectPoints, j: int) -> dict[str, list[float]]:
    """Coordinates and standard deviations; a sigma that is not known is 0."""
    return {"coordinates": points.values[j].tolist(), "sigmas": known(points.sigma[j]).tolist()}


def _calibrated(given: Block, pinholes: list[Pinhole]) -> dict[str, Any]:
    angles = np.degrees(given.images.values[:, :3]).tolist()
    cameras = [
        {"id": k + 1, "sensor_id": _sensor_id(given, sensor), "orientation_deg": angles[k], "position": place}
        for k, (sensor, place) in enumerate(
            zip(given.images.camera.tolist(), given.images.values[:, 3:].tolist(), strict=True)
        )
    ]
    sensors = [
        {"id": _sensor_id(given, k), "internals": _internals(pinhole)} for k, pinhole in enumerate(pinholes)
    ]
    return {"sensors": sensors, "cameras": cameras}


def _file(kind: str) -> str:
    return kind.replace("-", "_") + ".json"
