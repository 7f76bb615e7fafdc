"""The one table of what pictures state: fact, unit, meaning, the keys that makers write, and who uses it.

Keys are tags of EXIF by their names in the standard, or properties of XMP as "prefix:name"; the first one
that is written counts. What no maker of the table writes is sought by the bare name, whoever wrote it; what
is not found there either stays unknown. A new maker is a key more, a new fact one entry here and one field of
`image_facts.ImageFacts`.

Sources: EXIF 2.32 (CIPA DC-008); DJI, manuals of Zenmuse P1 (p. 22), Mavic 3M (p. 89-90) and Matrice 4
(p. 90-91); DJI Payload SDK (kinds of altitude); Pix4D, "XMP tags of cameras"; Parrot, ANAFI photo metadata;
Skydio, "Camera and metadata overview"; pictures of a Phantom 4 Multispectral and a Zenmuse H20T.

XMP packets of pictures: properties by the prefix and name that makers write, read as plain text.

No parser of XML stands behind it: entities are never expanded beyond the five characters of XML, nothing is
fetched, and length and number are bounded. Packets that lack their declarations, as some makers write them,
are read all the same.
"""

import html
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

LONGEST, MOST_TAGS, LONGEST_VALUE = 1 << 20, 4096, 200
# A tag with its attributes, and the text behind it.
_TAG = re.compile(r"<(/?)([A-Za-z][\w.-]*:[\w.-]+)((?:\s[^<>]*?)?)(/?)>([^<>]{0,201})")
_ATTRIBUTE = re.compile(r"([A-Za-z][\w.-]*:[\w.-]+)\s*=\s*(?:\"([^\"<>]*)\"|'([^'<>]*)')")
# Namespaces whose prefixes say too little: both senseFly and Pix4D write "Camera".
_PREFIXES = {
    "http://ns.sensefly.com/camera/1.0": "sensefly",
    "http://www.dji.com/drone-dji/1.0": "drone-dji",
    "http://pix4d.com/camera/1.0": "Camera",
    "http://www.parrot.com/drone-parrot/1.0": "drone-parrot",
    "https://www.skydio.com/drone-skydio/1.0": "drone-skydio",
}
# What holds properties and is none itself.
_PLAIN = ("rdf", "x", "xml")
ANY = "*"


def read_xmp(packet: str) -> dict[str, str]:
    """Read the properties of a packet.

    returns: values by "prefix:name", those of a structure by "prefix:structure/name", items of a list joined
        with commas; and by "*:name" whoever wrote them, for makers that are not known.
    """
    found = dict[str, str]()
    prefixes = dict[str, str]()
    for name, value in _properties(packet[:LONGEST], prefixes):
        text = html.unescape(value).strip()
        if text and len(text) <= LONGEST_VALUE:
            prefix, _, rest = name.partition(":")
            found[f"{prefixes.get(prefix, prefix)}:{rest}"] = text
            found[f"{ANY}:{rest}"] = text
    return found


def _properties(packet: str, prefixes: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Properties as they stand; declared prefixes go into a table."""
    open_tags = list[str]()
    items = dict[str, list[str]]()
    for count, (closes, tag, attributes, empty, text) in enumerate(_TAG.findall(packet)):
        if count == MOST_TAGS:
            return
        if closes:
            if tag in open_tags:
                del open_tags[len(open_tags) - 1 - open_tags[::-1].index(tag) :]
            if tag in items:
                yield tag, ",".join(items.pop(tag))
            continue
        plain = tag.split(":")[0] in _PLAIN
        outer = next((name for name in reversed(open_tags) if name.split(":")[0] not in _PLAIN), "")
        for name, double, single in _ATTRIBUTE.findall(attributes):
            prefix, _, rest = name.partition(":")
            if prefix == "xmlns":
                address = (double or single).rstrip("/").lower()
                prefixes |= {rest: _PREFIXES[address]} if address in _PREFIXES else {}
            elif prefix not in _PLAIN:
                yield f"{outer if plain else tag}/{rest}" if outer or not plain else name, double or single
        if plain and tag == "rdf:li" and outer and text.strip():
            items.setdefault(outer, []).append(text.strip())
        elif not plain and not empty and text.strip():
            yield f"{outer}/{tag.split(':')[1]}" if outer else tag, text
        if not empty:
            open_tags.append(tag)


Triple = tuple[float, float, float]
NOT_GIVEN: Triple = (math.nan, math.nan, math.nan)
Kind = Literal["number", "positive", "text", "moment", "triple", "made"]
Tags = Mapping[str, Any]
# Of these the bare name says too little.
_OWN = ("EXIF:", "GPS:", "sensefly:", "crs:")


@dataclass(frozen=True)
class Fact:
    """One fact of a picture.

    name: of its field in `ImageFacts`.
    kind: how it is read; "made" is computed of several tags, by `image_facts`.
    keys: in the order of preference; the three of a triple stand with blanks between them.
    used: where it is used.
    """

    name: str
    unit: str
    meaning: str
    kind: Kind
    keys: tuple[str, ...]
    used: str


def _dji(*names: str) -> tuple[str, ...]:
    """Keys as DJI writes them, and those that Autel has taken over under names of its own."""
    return tuple(f"{prefix}:{name}" for name in names for prefix in ("drone-dji", "drone-autel"))


def _triple_of(prefix: str, *names: str) -> str:
    return " ".join(f"{prefix}:{name}" for name in names)


_CAMERA, _CONDITIONS, _CHECKS, _START = (
    "camera groups",
    "certificate: conditions",
    "picture tests",
    "start values",
)
FACTS: tuple[Fact, ...] = (
    Fact("make", "", "maker of the camera", "text", ("EXIF:Make",), f"{_CAMERA}, certificate"),
    Fact("model", "", "model of the camera", "text", ("EXIF:Model",), f"{_CAMERA}, certificate"),
    Fact(
        "serial", "", "serial number of the body", "text",
        ("EXIF:BodySerialNumber", "EXIF:CameraSerialNumber", *_dji("CameraSerialNumber"),
        f"{ANY}:SerialNumber"),
        f"{_CAMERA}, certificate",
    ),
    Fact("lens", "", "lens", "text", ("EXIF:LensModel",), "certificate"),
    Fact(
        "lens_serial", "", "serial number of the lens", "text",
        ("EXIF:LensSerialNumber", *_dji("LensSerialNumber")), f"{_CAMERA}, certificate",
    ),
    Fact("firmware", "", "firmware", "text", ("EXIF:Software",), _CONDITIONS),
    Fact(
        "vehicle", "", "model of the aircraft", "text", _dji("DroneModel", "ProductName"),
        "certificate: campaign",
    ),
    Fact(
        "vehicle_serial", "", "serial number of the aircraft", "text",
        _dji("DroneSerialNumber", "DroneID"), "certificate: campaign",
    ),
    Fact("image_source", "", "which camera of several", "text", _dji("ImageSource"), _CAMERA),
    Fact(
        "orientation", "", "how a viewer turns the picture, 1 to 8", "made", ("EXIF:Orientation",),
        "reading",
    ),
    Fact(
        "full_size_px", "px", "size that the picture was stored with at first", "made",
        ("EXIF:ExifImageWidth", "EXIF:ExifImageHeight"), "size of the pictures in which marks were made",
    ),
    Fact("focal_mm", "mm", "focal length", "positive", ("EXIF:FocalLength",), f"{_START}, {_CHECKS} (zoom)"),
    Fact(
        "focal_35mm", "mm", "focal length of the same diagonal of 36 mm x 24 mm", "positive",
        ("EXIF:FocalLengthIn35mmFilm",), _START,
    ),
    Fact(
        "pitch_mm", "mm", "pitch of the stored pixels", "made",
        ("EXIF:FocalPlaneXResolution", "EXIF:FocalPlaneResolutionUnit", "EXIF:ExifImageWidth"), _START,
    ),
    Fact(
        "taken", "", "time of the camera's own clock, its zone unknown", "made",
        ("EXIF:DateTimeOriginal", "EXIF:DateTime", "EXIF:SubsecTimeOriginal"), "matching with events",
    ),
    Fact(
        "exposed_utc", "", "UTC of the exposure", "moment", _dji("UTCAtExposure"),
        "matching with events, in place of the camera's own clock",
    ),
    Fact(
        "gps_utc", "", "UTC of the position", "made", ("GPS:GPSDateStamp", "GPS:GPSTimeStamp"),
        "event lists",
    ),
    Fact(
        "latitude_deg", "deg", "latitude, WGS 84", "made",
        ("GPS:GPSLatitude", *_dji("GpsLatitude"), "drone-skydio:Latitude"), "positions",
    ),
    Fact(
        "longitude_deg", "deg", "longitude, WGS 84", "made",
        ("GPS:GPSLongitude", *_dji("GpsLongitude", "GpsLongtitude"), "drone-skydio:Longitude"), "positions",
    ),
    Fact(
        "altitude_m", "m", "height, of the kind that `height_kind` tells", "made",
        (*_dji("AbsoluteAltitude"), "drone-skydio:AbsoluteAltitude", "GPS:GPSAltitude"), "positions",
    ),
    Fact(
        "altitude_kind", "", "what the maker calls that height", "text", _dji("AltitudeType"),
        "height of a project",
    ),
    Fact(
        "relative_altitude_m", "m", "height above the take-off point", "number",
        (*_dji("RelativeAltitude"), "drone-skydio:RelativeAltitude"), "flying height, `photocal new`",
    ),
    Fact(
        "position_sigma_m", "m", "standard deviations of the position, east, north, up", "triple",
        (
            _triple_of("drone-dji", "RtkStdLon", "RtkStdLat", "RtkStdHgt"),
            _triple_of("Camera", "GPSXYAccuracy", "GPSXYAccuracy", "GPSZAccuracy"),
            _triple_of(
                "drone-skydio", "GpsHorizontalAccuracy", "GpsHorizontalAccuracy", "GpsVerticalAccuracy"
            ),
        ),
        "weights of positions, event lists",
    ),
    Fact(
        "rtk_flag", "", "solution: 50 fixed, 32 to 49 float, 16 single, 0 none", "number", _dji("RtkFlag"),
        f"{_CHECKS} (fix), height of a project",
    ),
    Fact(
        "rtk_age_s", "s", "age of the corrections", "number", _dji("RtkDiffAge"),
        f"{_CHECKS} (old corrections)",
    ),
    Fact(
        "surveying_mode", "", "1 where the maker recommends the picture for mapping", "number",
        _dji("SurveyingMode"), f"{_CHECKS} (fix)",
    ),
    Fact("caster", "", "host of the NTRIP caster", "text", _dji("NTRIPHost"), "certificate: positioning"),
    Fact(
        "mount_point", "", "mount point of the caster", "text", _dji("NTRIPMountPoint"),
        "certificate: positioning",
    ),
    Fact(
        "gimbal_deg", "deg", "roll, pitch, yaw of the camera (ZYX, north east down); pitch -90 looks down",
        "triple",
        (
            _triple_of("drone-dji", "GimbalRollDegree", "GimbalPitchDegree", "GimbalYawDegree"),
            _triple_of("drone-parrot", "CameraRollDegree", "CameraPitchDegree", "CameraYawDegree"),
            _triple_of(
                "drone-skydio", *(f"CameraOrientationNED/{name}" for name in ("Roll", "Pitch", "Yaw"))
            ),
        ),
        "attitudes, footprints, turned pictures",
    ),
    Fact(
        "vehicle_deg", "deg", "roll, pitch, yaw of the aircraft", "triple",
        (
            _triple_of("drone-dji", "FlightRollDegree", "FlightPitchDegree", "FlightYawDegree"),
            _triple_of("drone-parrot", "DroneRollDegree", "DronePitchDegree", "DroneYawDegree"),
            _triple_of("sensefly", "Roll", "Pitch", "Yaw"),
        ),
        "lever arm",
    ),
    Fact(
        "mount_deg", "deg", "roll, pitch, yaw by Pix4D's tags; of camera or aircraft, depending on the maker",
        "triple",
        (_triple_of("Camera", "Roll", "Pitch", "Yaw"),),
        "attitude of old Autel firmware (pitch 0 looks down); of others shown only",
    ),
    Fact(
        "gimbal_reverse", "", "1 where the gimbal hangs upside down", "number", _dji("GimbalReverse"),
        _CHECKS,
    ),
    Fact("camera_reverse", "", "1 where the camera is upside down", "number", _dji("CamReverse"), _CHECKS),
    Fact(
        "speed_m_s", "m/s", "speed over ground", "made", _dji("FlightXSpeed", "FlightYSpeed"),
        f"{_CHECKS} (smear)",
    ),
    Fact(
        "velocity_m_s", "m/s", "velocity east, north, up by the maker's inertial unit", "made",
        ("Camera:IMULinearVelocity",), "motion while a picture is read",
    ),
    Fact(
        "turns", "s, rad/s", "record of the maker's gyroscope", "made",
        ("Camera:IMUAngularVelocity", "Camera:IMUTimeOffset"), "motion while a picture is read",
    ),
    Fact(
        "exposure_s", "s", "exposure time", "positive", ("EXIF:ExposureTime",),
        f"{_CONDITIONS}, {_CHECKS} (smear)",
    ),
    Fact("iso", "", "sensitivity", "positive", ("EXIF:ISOSpeedRatings",), _CONDITIONS),
    Fact("f_number", "", "aperture", "positive", ("EXIF:FNumber",), f"{_CONDITIONS}, {_CHECKS} (lens)"),
    Fact(
        "shutter_type", "", "mechanical or electronic shutter", "text", _dji("ShutterType"),
        f"{_CONDITIONS}, {_CHECKS} (lens)",
    ),
    Fact("shutter_count", "", "exposures of the shutter so far", "number", _dji("ShutterCount"), _CONDITIONS),
    Fact(
        "focus_m", "m", "distance focused at", "positive", ("EXIF:SubjectDistance", *_dji("FocusDistance")),
        f"{_CONDITIONS}, {_CHECKS} (refocus)",
    ),
    Fact(
        "lens_position", "", "position of the focusing lens, in steps of the maker", "number",
        _dji("LensPosition"),
        f"{_CONDITIONS}, {_CHECKS} (refocus)",
    ),
    Fact(
        "sensor_temperature_c", "deg C", "temperature of the sensor", "number",
        (*_dji("SensorTemperature"), "Camera:SensorTemperature"), f"{_CONDITIONS}, `compare`",
    ),
    Fact(
        "lens_temperature_c", "deg C", "temperature of the lens", "number", _dji("LensTemperature"),
        f"{_CONDITIONS}, `compare`",
    ),
    Fact(
        "dewarped", "", "1 where the camera has taken the distortion out", "number", _dji("DewarpFlag"),
        f"{_START}, {_CHECKS} (corrected in the camera)",
    ),
    Fact(
        "lens_profile", "", "1 or True where a lens profile was applied", "text", ("crs:LensProfileEnable",),
        f"{_CHECKS} (corrected in the camera)",
    ),
    Fact(
        "sharpness", "", "sharpening in the camera: 0 normal, 1 soft, 2 hard", "number", ("EXIF:Sharpness",),
        f"{_CHECKS} (corrected in the camera)",
    ),
    Fact(
        "laser_m", "m", "distance that the laser rangefinder measured along the axis of the camera", "made",
        _dji("LRFTargetDistance", "LRFStatus"), "laser check, `photocal new`",
    ),
    Fact(
        "laser_target", "deg, m", "latitude, longitude and ellipsoidal height of what the laser hit",
        "triple",
        (_triple_of("drone-dji", "LRFTargetLat", "LRFTargetLon", "LRFTargetAbsAlt"),), "`photocal new`",
    ),
    Fact(
        "maker_camera", "",
        "calibration of the maker, readout of a line, and what joins pictures of one exposure",
        "made",
        (
            *_dji("DewarpData", "DewarpDataK6", "DewarpFlag", "CalibratedFocalLength", "CaptureUUID"),
            *(
                f"Camera:{name}"
                for name in (
                    "PerspectiveFocalLength", "PerspectiveDistortion", "PrincipalPoint",
                    "FisheyeAffineMatrix",
                    "FisheyePolynomial", "RigCameraIndex", "LineReadoutTime",
                )
            ),
            "MicaSense:CaptureId",
        ),
        f"{_START}, rigs, readout",
    ),
)  # fmt: skip


def read_table(tags: Tags) -> dict[str, Any]:
    """Read all facts of the table that need no more than their own tags, by name."""
    return {fact.name: _READERS[fact.kind](tags, fact.keys) for fact in FACTS if fact.kind != "made"}


def keys_of(name: str) -> tuple[str, ...]:
    """Keys of a fact."""
    return next(fact.keys for fact in FACTS if fact.name == name)


def stated(tags: Tags, keys: tuple[str, ...]) -> Any:
    """Give the first value that is there, by the keys themselves, then by their bare names in any XMP."""
    exact = (tags[key] for key in keys if tags.get(key) not in (None, "", b""))
    bare = (f"{ANY}:{key.partition(':')[2]}" for key in keys if not key.startswith(_OWN))
    return next(exact, next((tags[key] for key in bare if key in tags), None))


def as_text(value: object) -> str:
    """Text of a tag, cut at the first zero: what follows is left over memory."""
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    if not isinstance(value, str):
        return ""
    return "".join(c for c in value.split("\0")[0] if c.isprintable()).strip()


def as_number(value: Any) -> float:
    """Number of a tag; NaN for what is none."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return math.nan
    return number if math.isfinite(number) else math.nan


def as_positive(value: Any) -> float:
    """Positive number of a tag; NaN for others."""
    number = as_number(value)
    return number if number > 0 else math.nan


def as_moment(stamp: str, fraction: str = "") -> str:
    """Moment of a stamp of EXIF or XMP as ISO 8601 without zone; empty for what is none."""
    match = re.match(r"(\d{4})[:-](\d\d)[:-](\d\d)[ T](\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?", stamp)
    if not match or match[1] == "0000":
        return ""
    year, month, day, clock, part = match.groups()
    fraction = part or (fraction if fraction.isdigit() else "")
    return f"{year}-{month}-{day}T{clock}" + (f".{fraction}" if fraction else "")


def _triple(tags: Tags, keys: tuple[str, ...]) -> Triple:
    """Give the first of several triples that is stated in full."""
    for names in keys:
        first, second, third = (as_number(stated(tags, (name,))) for name in names.split())
        if math.isfinite(first + second + third):
            return first, second, third
    return NOT_GIVEN


_READERS: dict[str, Callable[[Tags, tuple[str, ...]], Any]] = {
    "number": lambda tags, keys: as_number(stated(tags, keys)),
    "positive": lambda tags, keys: as_positive(stated(tags, keys)),
    "text": lambda tags, keys: as_text(stated(tags, keys)),
    "moment": lambda tags, keys: as_moment(as_text(stated(tags, keys))),
    "triple": _triple,
}
