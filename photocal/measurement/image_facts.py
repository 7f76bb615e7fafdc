"""What an image says of itself: camera, size, time, position and attitude, from EXIF and XMP."""

import datetime as dt
import math
import re
import struct
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.measurement.image_file import noted, opened, stored_size
from photocal.measurement.recorded_turns import recorded_turns

if TYPE_CHECKING:
    from PIL.Image import Image

Triple = tuple[float, float, float]

_EXIF_IFD, _GPS_IFD = 0x8769, 0x8825
_NOT_GIVEN: Triple = (math.nan, math.nan, math.nan)
# Resolution units of EXIF: inch, cm, and two of other standards.
_MM_OF_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
_CAMERA_TAGS = (
    "DewarpData", "DewarpFlag", "CalibratedFocalLength", "PerspectiveFocalLength", "PerspectiveDistortion",
    "PrincipalPoint", "FisheyeAffineMatrix", "FisheyePolynomial", "RigCameraIndex", "CaptureUUID",
    "CaptureId", "LineReadoutTime",
)  # fmt: skip
# A value as attribute (name="value"), as element (<name>value</name>), or as list of such, of the XMP packet.
_XMP = re.compile(
    r"(?<=[\s<])([A-Za-z][\w.-]*):(\w+)"
    r"(?:=\"([^\"<>]{0,200})\"|>([^<>]{0,200})</|>\s*<rdf:Seq>((?:\s*<rdf:li>[^<>]{0,50}</rdf:li>){1,20}))"
)
_ITEM = re.compile(r"<rdf:li>([^<>]*)<")
# Attitude of the camera by DJI and Autel, and by Parrot; sigmas by DJI, and by Parrot and MicaSense.
_GIMBAL = (
    ("GimbalRollDegree", "GimbalPitchDegree", "GimbalYawDegree"),
    ("CameraRollDegree", "CameraPitchDegree", "CameraYawDegree"),
)
_ACCURACY = ("RtkStdLon", "RtkStdLat", "RtkStdHgt"), ("GPSXYAccuracy", "GPSXYAccuracy", "GPSZAccuracy")
# What `altitude_kind` is where nothing but the height above the take-off point is stated.
ABOVE_TAKE_OFF = "above take-off"


@dataclass(frozen=True)
class ImageFacts:
    """What an image file says of itself.

    name: file name.
    size_px: width and height of the stored pixel grid.
    orientation: EXIF orientation, 1 when not given: how a viewer turns the picture. The stored grid is used
        as is.
    make, model, serial: of the camera; empty when not given.
    focal_mm, focal_35mm: focal length, and its equivalent for a frame of 36 mm by 24 mm; NaN when not given.
    taken: time of the camera's own clock, without zone ("2016-06-23T16:31:59"); empty when not given.
    gps_utc: UTC of the position, ISO 8601; empty when not given.
    latitude_deg, longitude_deg: WGS 84; NaN when not given.
    altitude_m: as written; EXIF calls it "above sea level", drones write anything. Where nothing else is
        given, above the take-off point. NaN when not given.
    relative_altitude_m: above the take-off point (XMP); NaN when not given.
    gimbal_deg, vehicle_deg: roll, pitch, yaw of the camera and of the vehicle (XMP); pitch -90 looks down.
        NaN when not given.
    position_sigma_m: east, north, up, where the receiver wrote them (DJI RTK); NaN when not given.
    pitch_mm: of the stored pixels, from the FocalPlane tags; NaN when not given.
    altitude_kind: what the maker calls the altitude ("RtkAlt"); empty when not given.
    maker_camera: XMP tags about the camera, for `maker_camera.stated_camera`.
    c_px: principal distance that a person gives in place of all these; NaN when not given.
    exposure_s, iso: exposure time and sensitivity; NaN when not given.
    f_number, focus_m: aperture, and distance focused at; NaN when not given.
    lens, firmware: as the camera calls them; empty when not given.
    velocity_m_s: east, north, up, by the maker's inertial unit; NaN when not given.
    full_size_px: what EXIF says that the picture was stored with; zeros when not given.
    turns (n, 4): recorded by the maker's gyroscope, see `recorded_turns`; empty when not given.
    """

    name: str
    size_px: tuple[int, int]
    orientation: int = 1
    make: str = ""
    model: str = ""
    serial: str = ""
    focal_mm: float = math.nan
    focal_35mm: float = math.nan
    taken: str = ""
    latitude_deg: float = math.nan
    longitude_deg: float = math.nan
    altitude_m: float = math.nan
    relative_altitude_m: float = math.nan
    gimbal_deg: Triple = _NOT_GIVEN
    vehicle_deg: Triple = _NOT_GIVEN
    position_sigma_m: Triple = _NOT_GIVEN
    pitch_mm: float = math.nan
    altitude_kind: str = ""
    maker_camera: Mapping[str, str] = field(default_factory=dict)
    c_px: float = math.nan
    exposure_s: float = math.nan
    iso: float = math.nan
    f_number: float = math.nan
    focus_m: float = math.nan
    lens: str = ""
    firmware: str = ""
    velocity_m_s: Triple = _NOT_GIVEN
    full_size_px: tuple[int, int] = (0, 0)
    turns: Floats = field(default_factory=lambda: np.zeros((0, 4)), compare=False)

    @property
    def has_position(self) -> bool:
        """Whether latitude, longitude and a height are known."""
        return math.isfinite(self.latitude_deg + self.longitude_deg + self.altitude_m)


def read_facts(path: Path) -> ImageFacts:
    """Read what an image says of itself, without decoding its pixels.

    raises InputNotFoundError, InputMalformedError: when the file is no readable image.
    """
    with opened(path) as image:
        notes = noted(image)
        main, exif, gps = _tags(notes)
        packet = notes.info.get("xmp") or notes.info.get("XML:com.adobe.xmp") or b""
        text = packet.decode("utf-8", "replace") if isinstance(packet, bytes) else str(packet)
        xmp = {
            name: (a or b or ",".join(_ITEM.findall(listed))).strip()
            for _, name, a, b, listed in _XMP.findall(text)
        }
        size = stored_size(image)
    orientation = _number(main.get(0x0112))
    latitude = _angle(gps.get(2), _text(gps.get(1)), "S", 90.0)
    longitude = _angle(gps.get(4), _text(gps.get(3)), "W", 180.0)
    altitude, above = _altitude(gps, xmp), _number(xmp.get("RelativeAltitude"))
    if latitude == 0 == longitude:
        # What a receiver writes that has no position.
        latitude = longitude = altitude = math.nan
    only_above = math.isfinite(latitude + above) and not math.isfinite(altitude)
    return ImageFacts(
        path.name,
        size,
        int(orientation) if orientation in range(1, 9) else 1,
        _text(main.get(0x010F)),
        _text(main.get(0x0110)),
        _text(exif.get(0xA431)) or _text(main.get(0xC62F)) or xmp.get("SerialNumber", ""),
        _positive(exif.get(0x920A)),
        _positive(exif.get(0xA405)),
        _taken(_text(exif.get(0x9003)) or _text(main.get(0x0132)), _text(exif.get(0x9291))),
        latitude,
        longitude,
        above if only_above else altitude,
        above,
        _triple(xmp, *_GIMBAL),
        _triple(xmp, ("FlightRollDegree", "FlightPitchDegree", "FlightYawDegree")),
        _triple(xmp, *_ACCURACY),
        _pitch_mm(exif, size[0]),
        ABOVE_TAKE_OFF if only_above else xmp.get("AltitudeType", ""),
        {key: value for key, value in xmp.items() if key in _CAMERA_TAGS},
        exposure_s=_positive(exif.get(0x829A)),
        iso=_positive(exif.get(0x8827)),
        f_number=_positive(exif.get(0x829D)),
        focus_m=_positive(exif.get(0x9206)),
        lens=_text(exif.get(0xA434)),
        firmware=_text(main.get(0x0131)),
        velocity_m_s=_velocity(xmp),
        full_size_px=_full_size(exif),
        turns=recorded_turns(text if _of_sequoia(xmp) else "", _number(xmp.get("IMUTimeOffset"))),
    )


def _full_size(exif: Mapping[int, Any]) -> tuple[int, int]:
    width, height = (_number(exif.get(tag)) for tag in (0xA002, 0xA003))
    return (int(width), int(height)) if 0 < width < 1e6 and 0 < height < 1e6 else (0, 0)


def clock_seconds(facts: Sequence[ImageFacts]) -> Floats:
    """Times of images by their cameras' clocks from the first on, s, shape (n,); NaN where not given."""
    stamps = [
        dt.datetime.fromisoformat(image.taken).timestamp() if image.taken else math.nan for image in facts
    ]
    seconds = np.array(stamps, dtype=float)
    return seconds - np.nanmin(seconds) if np.isfinite(seconds).any() else seconds


def told_conditions(facts: Sequence[ImageFacts]) -> dict[str, dict[str, str]]:
    """Give what the pictures tell of their camera and its state, in sections of a certificate's particulars.

    Values that differ stand side by side; what no picture says is left out.
    """

    def both(name: str, form: str = "{}") -> str:
        """Write the values of one fact of all pictures, each once."""
        values = {getattr(image, name) for image in facts}
        return ", ".join(sorted(form.format(value) for value in values if value and str(value) != "nan"))

    camera = {"model": both("model"), "manufacturer": both("make"), "serial": both("serial")}
    camera["lens_type"] = both("lens")
    conditions = {
        "aperture": both("f_number", "f/{:g}"),
        "focus": both("focus_m", "{:g} m"),
        "firmware": both("firmware"),
    }
    sections = {"camera": camera, "conditions": conditions}
    return {
        name: {key: value for key, value in section.items() if value} for name, section in sections.items()
    }


def _velocity(xmp: Mapping[str, str]) -> Triple:
    """Velocity of Parrot's Sequoia, which counts it east, north, up; no other maker's is known."""
    if not _of_sequoia(xmp):
        return _NOT_GIVEN
    values = tuple(_number(cell) for cell in xmp.get("IMULinearVelocity", "").split(","))
    return values if len(values) == 3 and all(map(math.isfinite, values)) else _NOT_GIVEN


def _of_sequoia(xmp: Mapping[str, str]) -> bool:
    return "Sequoia" in xmp.get("RigName", "")


def _pitch_mm(exif: Mapping[int, Any], width: int) -> float:
    """Pitch of the stored pixels: the tags are of the picture that the camera wrote, of that width."""
    unit = _MM_OF_UNIT.get(int(_number(exif.get(0xA210, 2)) or 2), math.nan)
    written = _number(exif.get(0xA002, width))
    return unit / _positive(exif.get(0xA20E)) * (written / width if written > 0 else 1.0)


def _tags(image: "Image") -> tuple[Mapping[int, Any], Mapping[int, Any], Mapping[int, Any]]:
    """Give the main, EXIF and GPS directories; empty where they are damaged."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            exif = image.getexif()
            return dict(exif), dict(exif.get_ifd(_EXIF_IFD)), dict(exif.get_ifd(_GPS_IFD))
    except (SyntaxError, ValueError, KeyError, TypeError, OSError, struct.error, IndexError, OverflowError):
        return {}, {}, {}


def _text(value: object) -> str:
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    if not isinstance(value, str):
        return ""
    # Text tags are cut at the first zero; what follows is left over memory.
    return "".join(c for c in value.split("\0")[0] if c.isprintable()).strip()


def _number(value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return math.nan
    return number if math.isfinite(number) else math.nan


def _positive(value: Any) -> float:
    number = _number(value)
    return number if number > 0 else math.nan


def _triple(xmp: Mapping[str, str], *names: tuple[str, str, str]) -> Triple:
    """Give the first of several triples of tags that is stated, as makers call them."""
    for first, second, third in names:
        values = (_number(xmp.get(first)), _number(xmp.get(second)), _number(xmp.get(third)))
        if all(map(math.isfinite, values)):
            return values
    return _NOT_GIVEN


def _angle(value: Any, hemisphere: str, negative: str, limit: float) -> float:
    try:
        degrees, minutes, seconds = (_number(part) for part in value)
    except (TypeError, ValueError):
        return math.nan
    # Without its hemisphere the sign is unknown, and so is the angle.
    if not hemisphere:
        return math.nan
    angle = degrees + minutes / 60 + seconds / 3600
    return (-angle if hemisphere.upper() == negative else angle) if 0 <= angle <= limit else math.nan


def _altitude(gps: Mapping[int, Any], xmp: Mapping[str, str]) -> float:
    written, altitude = _number(xmp.get("AbsoluteAltitude")), _number(gps.get(6))
    below = gps.get(5, 0) in (1, b"\x01", 3, b"\x03")
    return written if math.isfinite(written) else -altitude if below else altitude


def _taken(stamp: str, fraction: str) -> str:
    match = re.match(r"(\d{4})[:-](\d\d)[:-](\d\d)[ T](\d\d:\d\d:\d\d)", stamp)
    if not match or match.group(1) == "0000":
        return ""
    year, month, day, clock = match.groups()
    return f"{year}-{month}-{day}T{clock}" + (f".{fraction}" if fraction.isdigit() else "")
