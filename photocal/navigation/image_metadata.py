"""What images say about themselves: time, camera, position and attitude (EXIF, XMP, file name)."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from pathlib import Path
from re import compile as pattern
from typing import Any

from drivers.errors import InputMalformedError, InputNotFoundError

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
_EXIF, _GPS = 0x8769, 0x8825
_ORIGINAL, _SUBSECOND, _SERIAL = 36867, 37521, 42033
_IN_NAME = pattern(r"(\d{14})(\d{2})Z$")
_XMP = pattern(rb'drone-dji:(\w+)(?:="|>)([^"<]*)')


@dataclass(frozen=True)
class ImageMetadata:
    """One image.

    Parameters
    ----------
    name : str
        File name.
    camera : str
        Maker, model and serial number as far as they are told.
    time_s : float or None
        Seconds since 1970 by the camera's (or the file name's) clock, time zone unknown.
    resolution_s : float
        1 where only whole seconds are told.
    from_name : bool
        Whether the time is that of the recording computer in the file name (UTC).
    lat_deg, lon_deg : float or None
        Position in the EXIF.
    altitude_m : float or None
        Height in the EXIF or `AbsoluteAltitude`: its kind is the maker's, mostly above sea level.
    relative_m : float or None
        `RelativeAltitude`: above the take-off.
    gimbal_deg : (float, float, float) or None
        Roll, pitch, yaw of the gimbal; pitch -90 looks down.
    """

    name: str
    camera: str
    time_s: float | None
    resolution_s: float
    from_name: bool
    lat_deg: float | None
    lon_deg: float | None
    altitude_m: float | None
    relative_m: float | None
    gimbal_deg: tuple[float, float, float] | None


def read_images(folder: Path) -> list[ImageMetadata]:
    """Read the metadata of the images in a folder, by name.

    Raises
    ------
    InputNotFoundError
        When the folder is missing or has no images.
    InputMalformedError
        When a file cannot be read as an image.
    """
    if not folder.is_dir():
        raise InputNotFoundError("is no folder", where=folder, remedy="name the folder of the images")
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES)
    if not paths:
        raise InputNotFoundError("has no images", where=folder, remedy="name the folder of the images")
    return [read_image(path) for path in paths]


def read_image(path: Path) -> ImageMetadata:
    """Read the metadata of one image, see `read_images`."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            exif = image.getexif()
            details, place = exif.get_ifd(_EXIF), exif.get_ifd(_GPS)
    except (OSError, ValueError, SyntaxError) as damage:
        raise InputMalformedError(
            "cannot be read as an image", where=path, remedy="remove it or copy it again"
        ) from damage
    told = (exif.get(271), exif.get(272), details.get(_SERIAL))
    camera = " ".join(str(part).strip("\0 ") for part in told if part)
    time, resolution, from_name = _time(path, exif, details)
    xmp = {key.decode(): value.decode("latin-1") for key, value in _XMP.findall(path.read_bytes()[:262_144])}
    gimbal = [_number(xmp.get(f"Gimbal{axis}Degree")) for axis in ("Roll", "Pitch", "Yaw")]
    known = [value for value in gimbal if value is not None]
    absolute = _number(xmp.get("AbsoluteAltitude"))
    return ImageMetadata(
        path.name,
        camera or "unknown",
        time,
        resolution,
        from_name,
        _angle(place, 2, "S"),
        _angle(place, 4, "W"),
        absolute if absolute is not None else _height(place),
        _number(xmp.get("RelativeAltitude")),
        (known[0], known[1], known[2]) if len(known) == 3 else None,
    )


def _time(path: Path, exif: Any, details: Any) -> tuple[float | None, float, bool]:
    stamp = details.get(_ORIGINAL) or exif.get(306)
    if stamp:
        try:
            moment = dt.datetime.strptime(str(stamp).strip("\0 "), "%Y:%m:%d %H:%M:%S").replace(tzinfo=dt.UTC)
        except ValueError:
            return None, 1.0, False
        part = str(details.get(_SUBSECOND, "")).strip("\0 ")
        if part.isdigit():
            return moment.timestamp() + int(part) / 10 ** len(part), 10.0 ** -len(part), False
        return moment.timestamp(), 1.0, False
    found = _IN_NAME.search(path.stem)
    if found is None:
        return None, 1.0, False
    try:
        moment = dt.datetime.strptime(found[1], "%Y%m%d%H%M%S").replace(tzinfo=dt.UTC)
    except ValueError:
        return None, 1.0, False
    return moment.timestamp() + int(found[2]) / 100, 0.01, True


def _angle(place: Any, key: int, negative: str) -> float | None:
    parts = place.get(key)
    if parts is None or len(parts) != 3:
        return None
    value = float(parts[0]) + float(parts[1]) / 60 + float(parts[2]) / 3600
    return -value if place.get(key - 1) == negative else value


def _height(place: Any) -> float | None:
    value = place.get(6)
    if value is None:
        return None
    below = place.get(5) in (1, b"\x01")
    return -float(value) if below else float(value)


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None
