"""Agisoft Metashape (PhotoScan): camera XML, as exported or as a project's doc.xml.

Pixels: x right, y down, the centre of the upper-left pixel is (0.5, 0.5), half a pixel more than ours; cx, cy
from the middle of the image. The distortion is added to the normalised projection (`brown-ideal`):
x' = x (1 + k1 r^2 + ... + k4 r^8) + (p1 (r^2 + 2 x^2) + 2 p2 x y) (1 + p3 r^2 + p4 r^4), and p1, p2 exchanged
for y; u = w/2 + cx + x' f + x' b1 + y' b2, v = h/2 + cy + y' f. Camera axes x right, y down, z forward; a
camera has the 4 x 4 matrix from camera to chunk, the chunk that to the world. f, cx, cy, b1, b2 in px. Older
files give fx, fy and cx, cy from the upper-left corner. Source: Metashape user manual, appendix "Camera
models".
"""

from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.block.model import ROLES, Block, Images, Role
from photocal.exchange.exporting import Choices
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.parts import (
    UNKNOWN,
    PointEntry,
    block,
    distinct,
    listed_pixels,
    object_points,
    rays_of,
)
from photocal.exchange.pinhole import from_vision, require_credible, to_vision
from photocal.exchange.rigs import of_metashape, slave_in_master
from photocal.exchange.source import child, image_size, number, numbers, read_xml, write_xml
from photocal.geometry.camera import Camera, camera
from photocal.geometry.conversion import Conversion, converted, in_pixels
from photocal.geometry.frames import ReferenceFrame, parsed
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles

# Our parameter for each key, its sign (y is up here and down there), and by which power of f it is divided.
TERMS: dict[str, tuple[str, int, int]] = {
    "f": ("c", 1, 0),
    "cx": ("x0", 1, 0),
    "cy": ("y0", -1, 0),
    "b1": ("B1", 1, 1),
    "b2": ("B2", -1, 1),
    **{f"k{n}": (f"K{n}", 1, 2 * n) for n in (1, 2, 3, 4)},
    "p1": ("P1", 1, 1),
    "p2": ("P2", -1, 1),
    "p3": ("P3", 1, 2),
    "p4": ("P4", 1, 4),
}


def read_metashape(path: Path) -> ForeignProject:
    """Read a camera XML.

    returns: cameras that are used, aligned images, markers as points and their projections as observations;
        sigmas of markers are NaN where they are not given. The block's frame is the chunk's coordinate
        system; unless that is local, its orientations are geocentric. Positions are those of the references.
    """
    return chunk_of(read_xml(path), path)


def chunk_of(root: Element, path: Path) -> ForeignProject:
    """Take the chunk out of a document; parameters and result as of `read_metashape`."""
    chunks = list(root.iter("chunk"))
    malformed = InputMalformedError.at(path)
    if root.tag != "document" or len(chunks) != 1:
        raise malformed(f"has {len(chunks)} chunks where one was expected", "export the cameras of one chunk")
    chunk = chunks[0]
    sensors = {
        sensor.get("id", ""): _camera(sensor, path)
        for sensor in chunk.iterfind("sensors/sensor")
        if sensor.find("calibration") is not None
    }
    poses_of = _matrices(chunk, path)
    shots = [shot for shot in chunk.iterfind("cameras/camera") if shot.get("id") in poses_of]
    lost = [shot for shot in shots if shot.get("sensor_id") not in sensors]
    if lost:
        raise malformed(f"image {lost[0].get('label')} has a sensor without calibration")
    names, order = image_names(chunk), {key: k for k, key in enumerate(sensors)}
    matrices = np.array([poses_of[shot.get("id", "")] for shot in shots])
    poses = _poses(matrices.reshape(-1, 4, 4), chunk_transform(chunk, path))
    listed = markers(chunk, path)
    position = {key: k for k, key in enumerate(listed)}
    image = {shot.get("id", ""): k for k, shot in enumerate(shots)}
    rays = []
    for marker in chunk.iterfind("frames/frame/markers/marker"):
        for seen in marker.iterfind("location"):
            if marker.get("marker_id") in position and seen.get("camera_id") in image:
                x, y = (number(seen.get(axis, ""), path, f"marker {axis}") for axis in "xy")
                rays.append((image[seen.get("camera_id", "")], position[marker.get("marker_id", "")], x, y))
    images = Images(
        tuple(names[shot.get("id", "")] for shot in shots),
        np.array([order[shot.get("sensor_id", "")] for shot in shots], dtype=np.int64),
        poses,
    )
    rays_seen = listed_pixels(rays, -0.5)
    points = object_points(listed.values())
    crs = (chunk.findtext("reference") or "").strip()
    frame = "local" if not crs or crs.startswith("LOCAL_CS") else crs
    given = Block(path.stem, frame, "", "control", tuple(sensors.values()), images, points, rays_seen)
    references = np.array([_reference(shot, path) for shot in shots], dtype=float).reshape(-1, 2, 3)
    positions, sigma = references[:, 0], references[:, 1]
    return ForeignProject("Metashape", of_metashape(given, shots), positions, sigma, normalised=True)


def local_chunk(chunk: ForeignProject) -> ForeignProject:
    """Take a chunk in a reference system to east, north and up at its middle."""
    crs = chunk.block.frame
    if crs == "local":
        return chunk
    images, points = chunk.block.images, chunk.block.points
    known = np.vstack([points.values, chunk.position])
    known = known[np.isfinite(known).all(axis=1)]
    if not len(known):
        raise InputMalformedError("has no coordinates in its system", "export markers or camera references")
    try:
        parsed(crs)
    except ConfigurationError as refusal:
        raise InputMalformedError(
            f"is in the coordinate system {crs[:60]!r}, which is not known",
            "export the cameras of a chunk in local coordinates, or in a system with an EPSG code",
        ) from refusal
    frame = ReferenceFrame(crs, known.mean(axis=0))
    origin, axes = frame.axes
    turned = angles_from_matrix(matrix_from_angles(images.values[:, :3]) @ axes.T)
    poses = np.hstack([turned, (images.values[:, 3:] - origin) @ axes.T])
    moved = replace(
        chunk.block,
        frame="local",
        images=replace(images, values=poses),
        points=replace(points, values=frame.to_local(points.values)),
    )
    return replace(chunk, block=moved, position=frame.to_local(chunk.position))


def _reference(shot: Element, path: Path) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position of an image and its standard deviations, as far as they are given and used."""
    given = shot.find("reference")
    if given is None or not given.get("x") or given.get("enabled", "true").lower() not in ("true", "1"):
        return UNKNOWN, UNKNOWN
    return tuple(number(given.get(axis, ""), path, "camera reference") for axis in "xyz"), _accuracy(
        given, path
    )


def image_names(chunk: Element) -> dict[str, str]:
    """Names of a chunk's images by their number."""
    shots = list(chunk.iterfind("cameras/camera"))
    labels = distinct(shot.get("label", "") for shot in shots)
    return {shot.get("id", ""): label for shot, label in zip(shots, labels, strict=True)}


def _matrices(chunk: Element, path: Path) -> dict[str, Floats]:
    """From camera to chunk axes of each aligned image; one without its own is where its master has it."""
    cameras = list(chunk.iterfind("cameras/camera"))
    sensors = {sensor.get("id"): sensor for sensor in chunk.iterfind("sensors/sensor")}
    matrices = {
        shot.get("id", ""): np.array(_numbers(child(shot, "transform", path), path, 16)).reshape(4, 4)
        for shot in cameras
        if shot.find("transform") is not None
    }
    for shot in cameras:
        master, sensor = matrices.get(shot.get("master_id", "")), sensors.get(shot.get("sensor_id"))
        if shot.get("id", "") not in matrices and master is not None and sensor is not None:
            matrices[shot.get("id", "")] = master @ slave_in_master(sensor, path)
    return matrices


def _camera(sensor: Element, path: Path) -> Camera:
    given = max(sensor.iterfind("calibration"), key=lambda element: element.get("class") == "adjusted")
    if given.get("type", "frame") != "frame":
        raise InputMalformedError(
            f"sensor {sensor.get('label')} is {given.get('type')}, not a frame camera", where=path
        )
    resolution = child(given, "resolution", path)
    sides = [number(resolution.get(side, ""), path, side) for side in ("width", "height")]
    width, height = image_size(sides[0], sides[1], path)
    value = dict.fromkeys(TERMS, 0.0)
    for element in given:
        if element.tag in (*TERMS, "fx", "fy", "skew"):
            value[element.tag] = number(element.text or "", path, element.tag)
    if "fx" in value:
        # The older form: principal point from the corner, and the affinity in fx and skew.
        value["f"] = value["fy"]
        value["b1"] = value["fx"] - value["fy"]
        value["b2"] = value.get("skew", 0.0)
        value["cx"], value["cy"] = value["cx"] - width / 2, value["cy"] - height / 2
    f = value["f"]
    require_credible((f,), [value[key] for key in TERMS if key != "f"], path)
    ours = {name: sign * value[key] / f**power for key, (name, sign, power) in TERMS.items()}
    name = sensor.get("label") or sensor.get("id") or "camera"
    return camera(name, "brown-ideal", "px", (width, height), (1.0, 1.0), ours, affinity="after")


def chunk_transform(chunk: Element, path: Path) -> Floats:
    """Matrix from chunk to world coordinates, shape (4, 4)."""
    matrix = np.eye(4)
    given = chunk.find("transform")
    if given is None:
        return matrix
    scale, rotation, translation = (given.find(key) for key in ("scale", "rotation", "translation"))
    if rotation is not None:
        matrix[:3, :3] = np.reshape(_numbers(rotation, path, 9), (3, 3))
    if scale is not None:
        matrix[:3, :3] *= _numbers(scale, path, 1)[0]
    if translation is not None:
        matrix[:3, 3] = _numbers(translation, path, 3)
    return matrix


def _poses(matrices: Floats, to_world: Floats) -> Floats:
    """Exterior orientations from camera-to-chunk matrices."""
    whole = to_world @ matrices
    axes = whole[:, :3, :3]
    axes = axes / np.cbrt(np.linalg.det(axes))[:, None, None] if len(axes) else axes
    rotation = np.swapaxes(axes, -1, -2)
    return from_vision(rotation, -np.einsum("nij,nj->ni", rotation, whole[:, :3, 3]))


def markers(chunk: Element, path: Path) -> dict[str, PointEntry]:
    """Markers by their number: tie points without coordinates, NaN where an accuracy is not given."""
    entries = {}
    for element in chunk.iterfind("markers//marker"):
        given = element.find("reference")
        xyz = sigma = UNKNOWN
        if given is not None and given.get("x"):
            x, y, z = (number(given.get(key, ""), path, f"marker {key}") for key in "xyz")
            xyz = x, y, z
            sigma = _accuracy(given, path)
        enabled = given is not None and given.get("enabled", "true").lower() in ("true", "1")
        name = element.get("label") or element.get("id") or ""
        role: Role = "tie" if np.isnan(xyz).any() else "control" if enabled else "check"
        entries[element.get("id", "")] = PointEntry(name, role, xyz, sigma)
    return entries


def _accuracy(given: Element, path: Path) -> tuple[float, float, float]:
    """Standard deviations: one for all, one for X and Y, or one each; NaN when not given."""
    sigma = []
    for axis in "xyz":
        keys = ["s" + axis, "sxyz"] + (["sxy"] if axis != "z" else [])
        text = next((given.get(key) for key in keys if given.get(key)), None)
        sigma.append(float("nan") if text is None else number(text, path, "marker accuracy"))
    return sigma[0], sigma[1], sigma[2]


def _numbers(element: Element, path: Path, count: int) -> list[float]:
    return numbers(element.text or "", path, element.tag, count)


def read(path: Path) -> ForeignProject:
    """Read cameras, aligned images and markers of a camera XML."""
    chunk = local_chunk(read_metashape(path))
    given = chunk.block
    made = block(path.stem, given.cameras, given.images, given.points, given.observations, [path])
    made = replace(made, heads=given.heads)
    return with_stated_positions(replace(chunk, block=made, camera_sigma=_camera_sigmas(path, made)))


def with_stated_positions(chunk: ForeignProject) -> ForeignProject:
    """Positions whose accuracy is not said weigh nothing: they are left out."""
    stated = (chunk.position_sigma > 0).all(axis=1, keepdims=True)
    position, sigma = (np.where(stated, values, np.nan) for values in (chunk.position, chunk.position_sigma))
    return replace(chunk, position=position, position_sigma=sigma)


def _camera_sigmas(path: Path, given: Block) -> dict[str, dict[str, float]]:
    """Standard deviations of the adjusted calibration, where the XML has their covariance."""
    sigmas: dict[str, dict[str, float]] = {}
    cameras = {camera.id: camera for camera in given.cameras}
    for sensor in read_xml(path).iter("sensor"):
        name = sensor.get("label") or sensor.get("id") or "camera"
        names = (sensor.findtext("covariance/params") or "").split()
        matrix = numbers(sensor.findtext("covariance/coeffs") or "", path, "covariance")
        if name not in cameras or not names or len(matrix) != len(names) ** 2:
            continue
        c = cameras[name].value("c")
        sigma = np.sqrt(np.diag(np.reshape(matrix, (len(names), len(names)))))
        sigmas[name] = {
            TERMS[key][0]: float(s) / c ** TERMS[key][2]
            for key, s in zip(names, sigma, strict=True)
            if key in TERMS
        }
    return sigmas


def detect(path: Path) -> bool:
    """Whether an XML file is one of cameras."""
    root = read_xml(path)
    # DBAT's set-ups are documents, too.
    return root.tag == "document" and "dbat_script_version" not in root.attrib


def write(path: Path, given: Block, _: Choices | None = None) -> tuple[Conversion, ...]:
    """Write a camera XML in local coordinates, with the control and check points as markers."""
    root = Element("document", version="1.5.0")
    chunk = SubElement(root, "chunk", label="photocal", enabled="true")
    sensors = SubElement(chunk, "sensors", next_id=str(len(given.cameras)))
    made = tuple(to_metashape(camera) for camera in given.cameras)
    for k, written in enumerate(conversion.camera for conversion in made):
        sensor = SubElement(sensors, "sensor", id=str(k), label=written.id, type="frame")
        width, height = (str(side) for side in written.size_px)
        SubElement(sensor, "resolution", width=width, height=height)
        calibration = SubElement(sensor, "calibration", {"type": "frame", "class": "adjusted"})
        SubElement(calibration, "resolution", width=width, height=height)
        for key, (name, sign, power) in TERMS.items():
            value = sign * written.value(name) * written.value("c") ** power
            if value or key in ("f", "cx", "cy"):
                SubElement(calibration, key).text = repr(value)
    rotation, translation = to_vision(given.images.values)
    shots = SubElement(chunk, "cameras", next_id=str(len(given.images.names)))
    for k, name in enumerate(given.images.names):
        matrix = np.eye(4)
        matrix[:3, :3] = rotation[k].T
        matrix[:3, 3] = -rotation[k].T @ translation[k]
        shot = SubElement(
            shots, "camera", id=str(k), sensor_id=str(given.images.camera[k]), label=name, enabled="true"
        )
        SubElement(shot, "transform").text = " ".join(repr(value) for value in matrix.ravel().tolist())
    _write_markers(chunk, given)
    crs = 'LOCAL_CS["Local Coordinates (m)",LOCAL_DATUM["Local Datum",0],UNIT["metre",1]]'
    SubElement(chunk, "reference").text = crs
    write_xml(path, root)
    return made


def to_metashape(camera: Camera) -> Conversion:
    """Express a camera in Metashape's model, still with our signs, in px."""
    flat = in_pixels(camera)
    terms = ["K1", "K2", "K3", "K4", "P1", "P2"]
    if flat.value("B1") or flat.value("B2"):
        terms += ["B1", "B2"]
    if camera.model == "brown-ideal":
        # In a fit P3 and P4 would stand on P1 and P2, which are nearly zero.
        terms += ["P3", "P4"]
    return converted(flat, "brown-ideal", "after", terms)


def _write_markers(chunk: Element, given: Block) -> None:
    points, seen_at = given.points, given.observations
    surveyed, rays = np.flatnonzero(~points.of_role("tie")), rays_of(seen_at.point, len(points.names))
    if not len(surveyed):
        return
    markers = SubElement(chunk, "markers", next_id=str(len(surveyed)))
    frame = SubElement(SubElement(chunk, "frames"), "frame", id="0")
    seen = SubElement(frame, "markers")
    for key, k in enumerate(surveyed.tolist()):
        marker = SubElement(markers, "marker", id=str(key), label=points.names[k])
        xyz = {axis: repr(value) for axis, value in zip("xyz", points.values[k].tolist(), strict=True)}
        if np.isfinite(points.sigma[k]).all():
            xyz |= {f"s{axis}": repr(s) for axis, s in zip("xyz", points.sigma[k].tolist(), strict=True)}
        SubElement(marker, "reference", {**xyz, "enabled": str(ROLES[points.role[k]] == "control").lower()})
        marks = SubElement(seen, "marker", marker_id=str(key))
        for ray in rays[k]:
            x, y = (seen_at.values[ray] + 0.5).tolist()
            SubElement(
                marks, "location", camera_id=str(seen_at.image[ray]), pinned="true", x=repr(x), y=repr(y)
            )
