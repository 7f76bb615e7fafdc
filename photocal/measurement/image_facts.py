"""What an image says of itself: camera, size, time, position and attitude, from EXIF and XMP.

How a camera turned while it was read, by the gyroscope whose record its pictures carry.
"""

import base64
import binascii
import datetime as dt
import html
import math
import operator
import re
import struct
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import legendre

from photocal.base.arrays import Floats
from photocal.geometry.camera import MOTION, SHAKE, SHAKE_DEGREES
from photocal.measurement.image_file import noted, opened, stored_size
from photocal.measurement.picture_facts import (
    NOT_GIVEN,
    Triple,
    as_moment,
    as_number,
    as_positive,
    as_text,
    keys_of,
    read_table,
    read_xmp,
    stated,
)

if TYPE_CHECKING:
    from PIL.Image import Image

# Records of Parrot's Sequoia: time, us; rates about its axes, rad/s; and undocumented bytes.
_RECORD = np.dtype([("time", "<u8"), ("rate", "<f4", 3), ("rest", "<u4")])
_RECORDS = re.compile(r":IMUAngularVelocity=\"([^\"<>]{0,100000})\"")
# Its axes point ahead, to the right and down; those of the camera to the right, ahead and up.
_TO_CAMERA = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def recorded_turns(packet: str, offset_ns: float) -> Floats:
    """Read the record of a picture's XMP packet.

    offset_ns: by how much the first record is before the first line (the tag IMUTimeOffset).
    returns (n, 4): times since the first line was read, s, and rates about the axes of the camera, rad/s;
        empty where there is none that can be read.
    """
    match = _RECORDS.search(packet)
    try:
        octets = base64.b64decode(html.unescape(match.group(1) if match else ""))
        records = np.frombuffer(octets, _RECORD)
    except (binascii.Error, ValueError):
        return np.zeros((0, 4))
    rate = records["rate"].astype(float)
    step = np.diff(records["time"].astype(float))
    # Nothing that carries a camera turns faster, rad/s.
    fastest = 50.0
    credible = (step > 0).all() and (np.abs(rate) < fastest).all()
    if len(records) < 2 or not np.isfinite(offset_ns) or not credible:
        return np.zeros((0, 4))
    # What is recorded was so much earlier: as filters delay it. Found by adjusting four exposures of one
    # head: medians of the residuals of 2.2 px without a delay, 1.4 with 20 ms, 0.6 with 40 and 45, 0.8 with
    # 50. With other readouts another delay fits best: 0.66 px for 150 ms, 0.68 for 175.
    delay_s = 0.042
    elapsed = 1e-6 * np.r_[0.0, np.cumsum(step)] - 1e-9 * offset_ns - delay_s
    return np.column_stack([elapsed, rate @ _TO_CAMERA.T])


def motion_while_read(velocity: Floats, records: Sequence[Floats], readout: Floats) -> tuple[Floats, Floats]:
    """Motion of images while they were read and its sigmas, as `block.model.Images` has them.

    velocity (n, 3): m/s, NaN where not known.
    records: of each image, see `recorded_turns`.
    readout (n,): of its camera, s.
    """
    motion = np.full((len(velocity), len(MOTION + SHAKE)), np.nan)
    sigma = np.full((len(velocity), len(MOTION)), np.nan)
    motion[:, :3] = velocity
    # The bias of such a gyroscope, and what an uncertain delay does, rad/s.
    rate_sigma = 0.02
    for k, record in enumerate(records):
        if len(record) and readout[k] > 0:
            motion[k, 3:] = turns_while_read(record, readout[k])
            sigma[k, 3:] = rate_sigma
    shaken = np.isfinite(motion[:, len(MOTION) :]).any()
    return motion if shaken else motion[:, : len(MOTION)], sigma


def turns_while_read(record: Floats, readout: float) -> Floats:
    """Motion of an image by a record: its rate, then Legendre polynomials of the line from degree 2.

    returns (18,): rad/s, of what the camera sees, as `block.model.Images.motion` has them.
    """
    line = np.linspace(-0.5, 0.5, 101)
    elapsed = (line + 0.5) * readout
    rate = np.column_stack([np.interp(elapsed, record[:, 0], axis) for axis in record[:, 1:].T])
    step = np.diff(elapsed)[:, None]
    turn = np.vstack([np.zeros(3), np.cumsum((rate[1:] + rate[:-1]) / 2 * step, axis=0)])
    parts = legendre.legfit(2.0 * line, -turn, SHAKE_DEGREES[-1])
    # The pose takes the mean; P1 is twice the line.
    return np.asarray(np.concatenate([2.0 * parts[1], parts[2:].ravel()]) / readout)


_EXIF_IFD, _GPS_IFD = 0x8769, 0x8825
# Resolution units of EXIF: inch, cm, and two of other standards.
_MM_OF_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
# What `altitude_kind` is where nothing but the height above the take-off point is stated.
ABOVE_TAKE_OFF = "above take-off"
# Kinds of height as DJI names them: the payload SDK says of both that they are ellipsoidal.
_ELLIPSOIDAL = ("rtkalt", "gpsfusionalt")
# Whose heights are above the geoid of 1996 (Parrot: ANAFI 4K, Thermal, USA; Skydio).
_EGM96 = ("parrot", "skydio")
FIXED, FLOATS = 50, range(32, 50)
# A file that changes twice within the clock's step keeps its times: so young ones are read again.
_YOUNG_NS, _MOST_KNOWN = 2_000_000_000, 20_000


# Programs that people edit pictures with, as they call themselves in EXIF.
_EDITORS = re.compile(
    r"adobe|photoshop|lightroom|gimp|darktable|rawtherapee|capture one|dxo|affinity|luminar|snapseed|acdsee|"
    r"paint\.net|picasa|irfanview|xnview|imagemagick|photoscape|digikam"
)


@dataclass(frozen=True)
class ImageFacts:
    """What an image file says of itself.

    name: file name.
    size_px: width and height of the stored pixel grid, which is used as is: `orientation` is for viewers.
    c_px: principal distance that a person gives in place of all that is stated; NaN when not given.
    altitude_kind: `ABOVE_TAKE_OFF` where nothing else was written; else as the maker calls it.
    turns (n, 4): see `recorded_turns`.
    full_size_px: zeros where it is not stated.
    table_apart_m: how far a table beside the picture puts it from where it says itself; NaN without a table.

    All others are in the table `picture_facts.FACTS`, with units and keys; numbers are NaN, texts empty where
    nothing is stated.
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
    gimbal_deg: Triple = NOT_GIVEN
    vehicle_deg: Triple = NOT_GIVEN
    position_sigma_m: Triple = NOT_GIVEN
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
    velocity_m_s: Triple = NOT_GIVEN
    full_size_px: tuple[int, int] = (0, 0)
    turns: Floats = field(default_factory=lambda: np.zeros((0, 4)), compare=False)
    lens_serial: str = ""
    vehicle: str = ""
    vehicle_serial: str = ""
    image_source: str = ""
    exposed_utc: str = ""
    gps_utc: str = ""
    rtk_flag: float = math.nan
    rtk_age_s: float = math.nan
    surveying_mode: float = math.nan
    caster: str = ""
    mount_point: str = ""
    mount_deg: Triple = NOT_GIVEN
    gimbal_reverse: float = math.nan
    camera_reverse: float = math.nan
    speed_m_s: float = math.nan
    shutter_type: str = ""
    shutter_count: float = math.nan
    lens_position: float = math.nan
    sensor_temperature_c: float = math.nan
    lens_temperature_c: float = math.nan
    dewarped: float = math.nan
    lens_profile: str = ""
    sharpness: float = math.nan
    laser_m: float = math.nan
    laser_target: Triple = NOT_GIVEN
    table_apart_m: float = math.nan

    @property
    def reduction(self) -> float:
        """Stored pixels for each that the camera wrote; 1 where that is not stated, or of another shape."""
        return _reduction(self.size_px, self.full_size_px)

    @property
    def cropped(self) -> bool:
        """Whether the camera wrote more than is stored, in another shape."""
        stored, written = sorted(self.size_px), sorted(self.full_size_px)
        return self.reduction == 1.0 and all(map(operator.ge, written, stored)) and stored != written

    @property
    def frame_px(self) -> tuple[int, int]:
        """Width and height of the whole frame, in stored pixels."""
        return self.full_size_px if self.cropped else self.size_px

    @property
    def has_position(self) -> bool:
        """Whether latitude, longitude and a height are known."""
        return math.isfinite(self.latitude_deg + self.longitude_deg + self.altitude_m)

    @property
    def fix(self) -> str:
        """What its receiver had solved: "fixed", "float", "single", or empty where it does not say."""
        if self.rtk_flag == FIXED:
            return "fixed"
        return "float" if self.rtk_flag in FLOATS else "single" if math.isfinite(self.rtk_flag) else ""

    @property
    def height_kind(self) -> str:
        """From where its height counts: "ellipsoidal", "EGM96", `ABOVE_TAKE_OFF`, or empty for unknown."""
        kind, make = self.altitude_kind, self.make.lower()
        if kind == ABOVE_TAKE_OFF or not math.isfinite(self.altitude_m):
            return kind if kind == ABOVE_TAKE_OFF else ""
        if kind.lower() in _ELLIPSOIDAL or (not kind and self.fix in ("fixed", "float")):
            return "ellipsoidal"
        geoid = make.startswith(_EGM96) and not self.model.lower().startswith("anafi ai")
        return "EGM96" if geoid and not kind else ""


# What was read, by path, size, times and number of each file.
_KNOWN: dict[tuple[str, int, int, int, int], ImageFacts] = {}


def is_edited(image: ImageFacts) -> bool:
    """Whether the program that wrote a picture corrects lenses, crops and scales."""
    return _EDITORS.search(image.firmware.casefold()) is not None


def read_facts(path: Path) -> ImageFacts:
    """Read what an image says of itself, without decoding its pixels.

    Every stage of a run asks: what was read of a file is kept as long as the file is the same.

    raises InputNotFoundError, InputMalformedError: when the file is not a readable image.
    """
    try:
        state = path.stat()
    except OSError:
        return _read(path)
    # The time of the change of its entry cannot be set back; a file that is just being written is not kept.
    same = (str(path), state.st_size, state.st_mtime_ns, state.st_ctime_ns, state.st_ino)
    known = _KNOWN.get(same)
    if known is not None:
        return known
    facts = _read(path)
    if time.time_ns() - max(state.st_mtime_ns, state.st_ctime_ns) > _YOUNG_NS:
        if len(_KNOWN) >= _MOST_KNOWN:
            _KNOWN.clear()
        _KNOWN[same] = facts
    return facts


def _read(path: Path) -> ImageFacts:
    with opened(path) as image:
        notes = noted(image)
        exif, gps = _tags(notes)
        packet = notes.info.get("xmp") or notes.info.get("XML:com.adobe.xmp") or b""
        text = packet.decode("utf-8", "replace") if isinstance(packet, bytes) else str(packet)
        size = stored_size(image)
    return facts_of_tags(path.name, size, exif | read_xmp(text), gps, text)


def facts_of_tags(
    name: str, size: tuple[int, int], tags: Mapping[str, Any], gps: Mapping[int, Any], packet: str = ""
) -> ImageFacts:
    """Make the facts of a picture from its tags, as `picture_facts` names them, and its GPS directory."""
    read = read_table(tags)
    if not min(read["position_sigma_m"]) > 0:
        # Zeros are what a receiver writes that has no solution.
        read["position_sigma_m"] = NOT_GIVEN
    orientation = as_number(tags.get("EXIF:Orientation"))
    latitude = _angle(gps.get(2), as_text(gps.get(1)), "S", 90.0)
    longitude = _angle(gps.get(4), as_text(gps.get(3)), "W", 180.0)
    if not gps:
        latitude, longitude = (
            as_number(stated(tags, keys_of(f"{one}_deg"))) for one in ("latitude", "longitude")
        )
    altitude, above = _altitude(gps, tags), read["relative_altitude_m"]
    if latitude == 0 == longitude:
        # What a receiver writes that has no position.
        latitude = longitude = altitude = math.nan
    only_above = math.isfinite(latitude + above) and not math.isfinite(altitude)
    if only_above:
        read["altitude_kind"] = ABOVE_TAKE_OFF
    mount, autel = read["mount_deg"], read["make"].lower().startswith("autel")
    if autel and not math.isfinite(read["gimbal_deg"][0]):
        # Its old firmware: 0 looks down, 90 to the horizon.
        read["gimbal_deg"] = mount[0], mount[1] - 90.0, mount[2]
    tag_of = {key.partition(":")[2]: stated(tags, (key,)) for key in keys_of("maker_camera")}
    moment = as_text(tags.get("EXIF:DateTimeOriginal")) or as_text(tags.get("EXIF:DateTime"))
    laser = as_positive(stated(tags, _dji_keys("laser_m", "LRFTargetDistance")))
    hit = as_text(stated(tags, _dji_keys("laser_m", "LRFStatus"))).lower() in ("", "normal")
    # No rangefinder of these cameras sees farther (DJI, specifications of the Zenmuse H30); 9999 is no shot.
    hit = hit and not laser > 3000.0
    sequoia = "Sequoia" in as_text(stated(tags, ("Camera:RigName",)))
    return ImageFacts(
        name,
        size,
        **read,
        orientation=int(orientation) if orientation in range(1, 9) else 1,
        taken=as_moment(moment, as_text(tags.get("EXIF:SubsecTimeOriginal"))),
        gps_utc=_gps_time(gps),
        latitude_deg=latitude,
        longitude_deg=longitude,
        altitude_m=above if only_above else altitude,
        pitch_mm=_pitch_mm(tags, _reduction(size, _full_size(tags))),
        full_size_px=_full_size(tags),
        speed_m_s=math.hypot(
            *(as_number(stated(tags, (key,))) for key in ("drone-dji:FlightXSpeed", "drone-dji:FlightYSpeed"))
        ),
        velocity_m_s=_velocity(tags) if sequoia else NOT_GIVEN,
        turns=recorded_turns(packet if sequoia else "", as_number(stated(tags, ("Camera:IMUTimeOffset",)))),
        laser_m=laser if hit else math.nan,
        maker_camera={key: str(value) for key, value in tag_of.items() if value is not None},
    )


def clock_seconds(facts: Sequence[ImageFacts]) -> Floats:
    """Times of images by their cameras' clocks from the first on, s, shape (n,); NaN where not given."""
    stamps = [
        dt.datetime.fromisoformat(image.taken).timestamp() if image.taken else math.nan for image in facts
    ]
    seconds = np.array(stamps, dtype=float)
    return seconds - np.nanmin(seconds) if np.isfinite(seconds).any() else seconds


def camera_temperatures(facts: Sequence[ImageFacts]) -> Floats:
    """Temperatures of the lenses, else of the sensors, deg C, shape (n,); NaN where not given."""
    lens = np.array([image.lens_temperature_c for image in facts], dtype=float)
    sensor = np.array([image.sensor_temperature_c for image in facts], dtype=float)
    return lens if np.isfinite(lens).any() else sensor


def _dji_keys(fact: str, name: str) -> tuple[str, ...]:
    """Those keys of a fact that end with a name."""
    return tuple(key for key in keys_of(fact) if key.endswith(f":{name}"))


def _velocity(tags: Mapping[str, Any]) -> Triple:
    """Velocity of Parrot's Sequoia, which counts it east, north, up; no other maker's is known."""
    values = tuple(as_number(cell) for cell in as_text(stated(tags, keys_of("velocity_m_s"))).split(","))
    return values if len(values) == 3 and all(map(math.isfinite, values)) else NOT_GIVEN


def _pitch_mm(tags: Mapping[str, Any], reduction: float) -> float:
    """Pitch of the stored pixels: the tags are of the picture that the camera wrote."""
    unit = _MM_OF_UNIT.get(int(as_number(tags.get("EXIF:FocalPlaneResolutionUnit", 2)) or 2), math.nan)
    return unit / as_positive(tags.get("EXIF:FocalPlaneXResolution")) / reduction


def _reduction(stored: tuple[int, int], written: tuple[int, int]) -> float:
    """Stored pixels for each that was written, of a picture that may be turned; 1 for another shape."""
    (shorter, longer), (less, more) = sorted(stored), sorted(written)
    # A pixel of rounding.
    return longer / more if less and abs(shorter - less * longer / more) <= 1 else 1.0


def _full_size(tags: Mapping[str, Any]) -> tuple[int, int]:
    width, height = (as_number(tags.get(f"EXIF:ExifImage{side}")) for side in ("Width", "Height"))
    return (int(width), int(height)) if 0 < width < 1e6 and 0 < height < 1e6 else (0, 0)


def _tags(image: "Image") -> tuple[dict[str, Any], Mapping[int, Any]]:
    """Give the tags of main and EXIF directory by their names, and the GPS directory; empty if damaged."""
    from PIL.ExifTags import Base

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            exif = image.getexif()
            main, own, gps = dict(exif), dict(exif.get_ifd(_EXIF_IFD)), dict(exif.get_ifd(_GPS_IFD))
    except (SyntaxError, ValueError, KeyError, TypeError, OSError, struct.error, IndexError, OverflowError):
        return {}, {}
    names = {tag.value: f"EXIF:{tag.name}" for tag in Base}
    return {names[tag]: value for tag, value in (main | own).items() if tag in names}, gps


def _gps_time(gps: Mapping[int, Any]) -> str:
    """UTC of the position: a day, and hours, minutes and seconds as three numbers."""
    try:
        hours, minutes, seconds = (as_number(part) for part in gps.get(7, ()))
        clock = dt.timedelta(hours=hours, minutes=minutes, seconds=round(seconds, 6))
        day = dt.datetime.strptime(as_text(gps.get(29)), "%Y:%m:%d")
    except (TypeError, ValueError, OverflowError):
        return ""
    return (day + clock).isoformat()


def _angle(value: Any, hemisphere: str, negative: str, limit: float) -> float:
    try:
        degrees, minutes, seconds = (as_number(part) for part in value)
    except (TypeError, ValueError):
        return math.nan
    # Without its hemisphere the sign is unknown, and so is the angle.
    if not hemisphere:
        return math.nan
    angle = degrees + minutes / 60 + seconds / 3600
    return (-angle if hemisphere.upper() == negative else angle) if 0 <= angle <= limit else math.nan


def _altitude(gps: Mapping[int, Any], tags: Mapping[str, Any]) -> float:
    written, altitude = as_number(stated(tags, keys_of("altitude_m")[:-1])), as_number(gps.get(6))
    below = gps.get(5, 0) in (1, b"\x01", 3, b"\x03")
    return written if math.isfinite(written) else -altitude if below else altitude
