"""OpenSfM and ODM: cameras.json and reconstruction.json.

Image coordinates are divided by the larger side of the image and counted from its middle, x right, y down
(a pixel's column is x * size + w/2 - 0.5, so that the centre of the upper-left pixel is (0, 0), as ours).
The distortion is added to the normalised projection (`brown-ideal`): "perspective" has focal, k1, k2;
"brown" has focal_x, focal_y, c_x, c_y, k1, k2, k3, p1, p2. "fisheye" and "fisheye_opencv" are `equidistant`
with two and four coefficients, written as the latter. Camera axes x right, y down, z forward; a shot
has the rotation vector and translation from object to camera axes. Object space: east, north, up in m about
`reference_lla`. Source: OpenSfM documentation, "Geometric models" and "Reconstruction format".
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from photocal.base.errors import InputMalformedError
from photocal.block.model import NO_OBSERVATIONS, NO_POINTS, Block, Images, ObjectPoints
from photocal.exchange.exporting import Choices
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.parts import block, listed_pixels, of_cameras, utm_zone_of
from photocal.exchange.pinhole import Pinhole, from_pinhole, from_vision, to_pinhole, to_vision
from photocal.exchange.rigs import of_opensfm
from photocal.exchange.source import image_size, number, read_json, read_lines, structured
from photocal.geometry.camera import Camera
from photocal.geometry.conversion import Conversion
from photocal.geometry.frames import UNSTATED


def read(path: Path) -> ForeignProject:
    """Read a reconstruction with the tracks beside it."""
    given, tracks = read_reconstruction(path), tracks_beside(path)
    if not len(given.observations.image) and not tracks.is_file():
        raise InputMalformedError(
            "has no measurements", f"put the tracks beside it as {tracks.name}", where=path
        )
    return ForeignProject("OpenSfM", given, normalised=True)


def read_reconstruction(path: Path) -> Block:
    """Read the first reconstruction of reconstruction.json, with its tracks where they are beside it."""
    content = read_json(path)
    if not isinstance(content, list) or not content:
        raise InputMalformedError("holds no reconstruction", "is it an OpenSfM file?", where=path)

    tracks = tracks_beside(path)
    files = [path, tracks] if tracks.is_file() else [path]

    def made() -> Block:
        """Make the block of the first reconstruction."""
        first = content[0]
        cameras = {name: _camera(name, keys, path) for name, keys in first["cameras"].items()}
        order = {name: k for k, name in enumerate(cameras)}
        shots, points = first["shots"], first.get("points", {})
        turns = np.array([shot["rotation"] for shot in shots.values()], dtype=float).reshape(-1, 3)
        shifts = np.array([shot["translation"] for shot in shots.values()], dtype=float).reshape(-1, 3)
        images = Images(
            tuple(shots),
            np.array([order[shot["camera"]] for shot in shots.values()], dtype=np.int64),
            from_vision(Rotation.from_rotvec(turns).as_matrix(), shifts),
        )
        xyz = np.array([point["coordinates"] for point in points.values()], dtype=float).reshape(-1, 3)
        listed = ObjectPoints(tuple(points), xyz)
        return block(path.stem, tuple(cameras.values()), images, listed, NO_OBSERVATIONS, files)

    given = of_opensfm(structured(path, "an OpenSfM file", made), path, content[0])
    return _with_tracks(given, tracks) if tracks.is_file() else given


def read_shots(path: Path) -> ForeignProject:
    """Read ODM's shots.geojson: orientations in the zone of the pictures, of images of unknown cameras.

    A feature has the rotation vector from the map's to camera axes, and as its translation the projection
    centre in the UTM zone that ODM has chosen (before 2021 and without positions in axes of its own).
    """
    features = structured(path, "a shots.geojson of ODM", lambda: list(read_json(path)["features"]))

    def made() -> tuple[tuple[str, ...], Any, Any, Any]:
        """Take names, rotation vectors, places in metres and in degrees."""
        own = [feature["properties"] for feature in features]
        turns, places = (
            np.array([each[key] for each in own], dtype=float).reshape(-1, 3)
            for key in ("rotation", "translation")
        )
        lonlat = np.array([feature["geometry"]["coordinates"][:2] for feature in features], dtype=float)
        return tuple(str(each["filename"]) for each in own), turns, places, lonlat.reshape(-1, 2)

    names, turns, places, lonlat = structured(path, "a shots.geojson of ODM", made)
    if not names:
        raise InputMalformedError("has no shots", "did ODM finish without errors?", where=path)
    rotation = Rotation.from_rotvec(turns).as_matrix()
    poses = from_vision(rotation, -np.einsum("nij,nj->ni", rotation, places))
    frame, remarks = utm_zone_of(lonlat, places)
    images = Images(names, np.full(len(names), -1), poses)
    given = block(path.stem, (), images, NO_POINTS, NO_OBSERVATIONS, [path])
    height = "" if frame == "local" else UNSTATED
    return ForeignProject("ODM", replace(given, frame=frame, height=height), remarks=remarks)


def tracks_beside(path: Path) -> Path:
    """Where the tracks of a reconstruction are looked for."""
    return path.with_name(path.stem.replace("reconstruction", "tracks", 1) + ".csv")


def _with_tracks(given: Block, path: Path) -> Block:
    image = {name: k for k, name in enumerate(given.images.names)}
    point = {name: k for k, name in enumerate(given.points.names)}
    rays = []
    for line in read_lines(path, comment=""):
        cells = line.text.split("\t")
        if len(cells) == 1 and cells[0].startswith("OPENSFM_TRACKS_VERSION"):
            continue
        if len(cells) < 5:
            raise line.malformed(
                f"has {len(cells)} cells where a track has image, track, feature, x, y", "is it truncated?"
            )
        if cells[0] in image and cells[1] in point:
            x, y = (number(cell, line.place, "track") for cell in cells[3:5])
            rays.append((image[cells[0]], point[cells[1]], x, y))
    given = replace(given, observations=listed_pixels(rays))
    size = of_cameras(given, "size_px")
    values = given.observations.values * size.max(axis=1, keepdims=True) + size / 2 - 0.5
    return replace(given, observations=replace(given.observations, values=values))


def write(folder: Path, given: Block, _: Choices | None = None) -> tuple[Conversion, ...]:
    """Write cameras.json, reconstruction.json and tracks.csv."""
    made = [
        to_pinhole(camera, "OpenSfM", {"equidistant": ("K1", "K2", "K3", "K4")}) for camera in given.cameras
    ]
    names = [camera.id for camera in given.cameras]
    cameras = {name: _keys(pinhole) for name, (pinhole, _) in zip(names, made, strict=True)}
    rotation, translation = to_vision(given.images.values)
    turns = Rotation.from_matrix(rotation).as_rotvec()
    shots = {
        name: {"rotation": turn, "translation": shift, "camera": names[which]}
        for name, turn, shift, which in zip(
            given.images.names, turns.tolist(), translation.tolist(), given.images.camera, strict=True
        )
    }
    points = {
        name: {"color": [128, 128, 128], "coordinates": xyz}
        for name, xyz in zip(given.points.names, given.points.values.tolist(), strict=True)
    }
    whole = [{"cameras": cameras, "shots": shots, "points": points}]
    (folder / "cameras.json").write_text(json.dumps(cameras, indent=1, allow_nan=False), encoding="utf-8")
    (folder / "reconstruction.json").write_text(json.dumps(whole, allow_nan=False), encoding="utf-8")
    _write_tracks(folder / "tracks.csv", given)
    return tuple(conversion for _, conversion in made)


def _write_tracks(path: Path, given: Block) -> None:
    seen, size = given.observations, of_cameras(given, "size_px")
    normalised = (seen.values + 0.5 - size / 2) / size.max(axis=1, keepdims=True)
    count = np.zeros(len(given.images.names), dtype=np.int64)
    with path.open("w", encoding="utf-8", newline="\n") as out:
        out.write("OPENSFM_TRACKS_VERSION_v2\n")
        rays = zip(seen.image.tolist(), seen.point.tolist(), normalised.tolist(), strict=True)
        for image, point, (x, y) in rays:
            row = [given.images.names[image], given.points.names[point], count[image], repr(x), repr(y)]
            out.write("\t".join(str(cell) for cell in [*row, 0.001, 128, 128, 128, -1, -1]) + "\n")
            count[image] += 1


def _keys(pinhole: Pinhole) -> dict[str, Any]:
    width, height = pinhole.size_px
    size = max(pinhole.size_px)
    return {
        "projection_type": "fisheye_opencv" if pinhole.fisheye else "brown",
        "width": width,
        "height": height,
        "focal_x": pinhole.fx / size,
        "focal_y": pinhole.fy / size,
        "c_x": (pinhole.cx + 0.5 - width / 2) / size,
        "c_y": (pinhole.cy + 0.5 - height / 2) / size,
    } | {name: getattr(pinhole, name) for name in _terms(pinhole.fisheye)}


def _terms(fisheye: bool) -> tuple[str, ...]:
    return ("k1", "k2", "k3", *(("k4",) if fisheye else ("p1", "p2")))


def _camera(name: str, keys: dict[str, Any], path: Path) -> Camera:
    width, height = image_size(float(keys["width"]), float(keys["height"]), path)
    size = max(width, height)
    kind = keys["projection_type"]
    if kind in ("perspective", "fisheye"):
        f = float(keys["focal"])
        fx, fy, cx, cy = f, f, 0.0, 0.0
        names: tuple[str, ...] = ("k1", "k2")
    elif kind in ("brown", "fisheye_opencv"):
        fx, fy, cx, cy = (float(keys[key]) for key in ("focal_x", "focal_y", "c_x", "c_y"))
        names = _terms(kind != "brown")
    else:
        raise InputMalformedError(
            f"camera {name} is {kind!r}, which has no equivalent",
            "use brown, perspective, fisheye or fisheye_opencv",
            where=path,
        )
    values = {key: float(keys.get(key, 0.0)) for key in names}
    middle = cx * size + width / 2 - 0.5, cy * size + height / 2 - 0.5
    pinhole = replace(
        Pinhole((width, height), fx * size, fy * size, *middle, fisheye=kind.startswith("fisheye")),
        **values,  # type: ignore[arg-type]
    )
    return from_pinhole(pinhole, name, path)
