"""The camera that a picture states: parameters that its maker wrote, as prior values with a stated sigma.

DJI's `DewarpData` ("date;fx,fy,cx,cy,k1,k2,p1,p2,k3", px, cx and cy from the middle of the picture),
`DewarpDataK6` (the same with k4, k5, k6 of the rational lens) and `CalibratedFocalLength` (designed, px), and
the tags of Pix4D's XMP that Parrot and MicaSense write: the focal length in mm goes with the pitch of the
FocalPlane tags; of a fisheye the scale at its middle is taken. Sources: DJI Matrice 4 manual; Pix4D, "XMP
tags of cameras".

A maker's calibration is a prior, not a truth. On a Phantom 4 Multispectral fx and fy differ by 0.9 %, 7 px at
the edge, where its pixels are square to 0.1 %; p1 equals p2 to the last digit, and both are 6 px in the
corner too large; cy has the opposite sign. Its radial terms are right to 2 %. Priors are as wide as that.

A maker's tag against the camera that an adjustment found: how far apart they record the same rays.

Cameras on one frame, recognised_heads by the names of their pictures: which belong to one exposure.
"""

import math
import re
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cache
from importlib import resources
from itertools import combinations
from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.geodesy import enu_offsets
from photocal.base.policy import policy
from photocal.exchange.pinhole import Pinhole, from_pinhole
from photocal.findings.finding import Finding
from photocal.geometry.camera import PARAMETERS, Camera, camera
from photocal.geometry.distortion import projected, undistorted
from photocal.measurement.image_facts import ImageFacts, is_edited

# What a parameter may be wrong by, as the shift of a point in the corner of the picture over c: measured for
# each specimen (10 px of 2000, the worst of a Phantom 4 Multispectral is 7), designed by its maker, read of
# tags of the lens, and guessed.
MEASURED, DESIGNED, STATED, GUESSED = 0.005, 0.01, 0.03, 0.2
# Cameras whose tag counts cy upwards. Four pictures of an FC6360 put the principal point 11.2 px (sigma 0.4)
# below the middle, where its tag has -11.4; all others are read as OpenCV counts, downwards.
CY_UPWARDS = ("fc6360",)
_RADIAL = {"K1": 3, "K2": 5, "K3": 7}
# A "35 mm equivalent" is stated for the diagonal of 36 mm by 24 mm (CIPA DCG-001; DJI); some take the width,
# which agrees for frames of 3 : 2.
FRAME_WIDTH_MM, FRAME_DIAGONAL_MM = 36.0, math.hypot(36.0, 24.0)
# Tags that give less or more than these shares of the longer side, or are unlike the equivalent by this
# logarithm, are wrong. Where nothing is known: a field of view of 60 degrees along the longer side.
LEAST_WIDTHS, MOST_WIDTHS, UNLIKE = 0.2, 50.0, 0.25
UNKNOWN_WIDTHS = 1 / (2 * math.tan(math.radians(30)))


@dataclass(frozen=True)
class StatedCamera:
    """A camera to start from.

    camera: in px; without what is estimated.
    source: where it comes from, for people.
    share: prior sigma: the shift in the corner that a wrong parameter may make, over c.
    """

    camera: Camera
    source: str
    share: float

    @property
    def guessed(self) -> bool:
        """Whether the principal distance is not stated."""
        return self.share >= GUESSED

    def prior_sigma(self) -> dict[str, float]:
        """Prior sigmas of c, x0, y0, and of the distortion and affinity where stated; px in their powers."""
        c = self.camera.value("c")
        corner = math.hypot(*self.camera.size_px) / 2
        shift = self.share * c
        # A principal point lies where the lens is mounted, whatever is known of c.
        sigma = {"c": shift, "x0": min(self.share, STATED) * c, "y0": min(self.share, STATED) * c}
        if self.camera.stated_by:
            return sigma | self._sigma_of_tag(shift, corner / c if self.camera.lens.relative else corner)
        if self.camera.model == "pix4d-fisheye":
            # Terms of the angle in right angles.
            angle = corner / c / (math.pi / 2)
            sigma |= {f"K{n}": self.share * 2 / math.pi / angle ** (n + 1) for n in (1, 2)}
        elif self.camera.values[PARAMETERS.index("K1")]:
            sigma |= {name: shift / corner**power for name, power in _RADIAL.items()}
            sigma |= dict.fromkeys(("P1", "P2"), shift / (3 * corner**2))
        if self.camera.rolling:
            # Sigma of a readout that a maker states, s: his clock is exact, what his lines are is not said.
            readout_sigma_s = 0.002
            sigma["readout"] = readout_sigma_s
        return sigma

    def _sigma_of_tag(self, shift: float, corner: float) -> dict[str, float]:
        """Prior sigmas of what a maker's tag states: as large as a wrong sign of it, at least."""
        own, relative = self.camera, self.camera.lens.relative
        move = self.share if relative else shift
        sigma = {name: math.hypot(shift, own.value(name)) for name in ("x0", "y0")}
        # Which of fx and fy is right, nobody knows.
        sigma["c"] = math.hypot(shift, own.value("c") * own.value("B1"))
        sigma |= {name: move / corner**power for name, power in _RADIAL.items()}
        if relative:
            # Numerator and denominator bend alike.
            sigma |= {below: sigma[above] for above, below in (("K1", "K4"), ("K2", "K5"), ("K3", "K6"))}
        sigma |= {name: math.hypot(move / (3 * corner**2), own.value(name)) for name in ("P1", "P2")}
        # Rows of pixels stand at a right angle to columns to this: no maker states it, no sensor is worse.
        shear = 1e-3
        # Half the width is what a wrong ratio of fx and fy shifts.
        return sigma | {"B1": math.hypot(2 * shift / own.size_px[0], own.value("B1")), "B2": shear}


def stated_camera(name: str, facts: ImageFacts) -> StatedCamera:
    """Give the best camera that a picture tells of, with the readout that its maker states."""
    stated = _stated_lens(name, facts)
    line = _numbers(facts.maker_camera.get("LineReadoutTime", ""))
    if len(line) != 1 or not line[0] > 0 or not math.isfinite(facts.velocity_m_s[0]):
        return stated
    values = stated.camera.values.copy()
    values[PARAMETERS.index("readout")] = 1e-9 * line[0] * facts.frame_px[1] / facts.reduction
    return replace(stated, camera=replace(stated.camera, values=values, shutter="rolling"))


def _stated_lens(name: str, facts: ImageFacts) -> StatedCamera:
    """Give the lens that a picture tells of."""
    width, height = facts.size_px
    middle = (width - 1) / 2, (height - 1) / 2
    xmp = facts.maker_camera
    if (tag := _dewarp(name, facts)) is not None:
        return tag
    pitch = facts.pitch_mm
    focal = _numbers(xmp.get("PerspectiveFocalLength", ""))
    place, terms = (_numbers(xmp.get(key, "")) for key in ("PrincipalPoint", "PerspectiveDistortion"))
    if len(focal) == 1 and focal[0] > 0 and len(place) == 2 and len(terms) == 5 and pitch > 0:
        k1, k2, k3, p1, p2 = terms
        c, x, y = focal[0] / pitch, place[0] / pitch - 0.5, place[1] / pitch - 0.5
        given = Pinhole(facts.size_px, c, c, x, y, k1, k2, k3, p1, p2)
        return StatedCamera(from_pinhole(given, name, facts.name), "XMP calibration of its maker", DESIGNED)
    fisheye = _numbers(xmp.get("FisheyeAffineMatrix", ""))
    if len(fisheye) == 4 and fisheye[0] > 0:
        # Pixels for a quarter turn: what the picture shows is wider than that of a perspective.
        c = fisheye[0] / (math.pi / 2)
        lens = start_camera(name, facts, c, ())
        bend = _numbers(xmp.get("FisheyePolynomial", ""))
        if len(place) == 2 and pitch > 0 and 2 < len(bend) <= 5 and bend[:2] == [0.0, 1.0]:
            values = {"c": c, "x0": place[0] / pitch - width / 2, "y0": height / 2 - place[1] / pitch}
            values |= {f"K{n}": value for n, value in enumerate(bend[2:], start=1)}
            lens = camera(name, "pix4d-fisheye", "px", facts.size_px, (1.0, 1.0), values, affinity="after")
            return StatedCamera(lens, "XMP fisheye of its maker", DESIGNED)
        return StatedCamera(lens, "XMP fisheye of its maker, at the middle of the picture", STATED)
    designed = [c * facts.reduction for c in _numbers(xmp.get("CalibratedFocalLength", ""))]
    if len(designed) == 1 and _may_be(designed[0], facts):
        lens = from_pinhole(Pinhole(facts.size_px, designed[0], designed[0], *middle), name, facts.name)
        return StatedCamera(lens, "CalibratedFocalLength of its maker", DESIGNED)
    c, source = principal_distance_px(facts)
    guessed = source.startswith(("assumed", "guess"))
    # The other convention of an equivalent lies one sigma away.
    convention = abs(math.log(_equivalents_px(facts)[0] / _equivalents_px(facts)[1]))
    share = max(STATED, convention) if "equivalent" in source else GUESSED if guessed else STATED
    return StatedCamera(start_camera(name, facts, c, ()), source, share)


def _dewarp(name: str, facts: ImageFacts) -> StatedCamera | None:
    """The camera of `DewarpDataK6`, else of `DewarpData`; None without, or where it was applied already."""
    xmp, middle = facts.maker_camera, [(side - 1) / 2 for side in facts.size_px]
    if xmp.get("DewarpFlag", "0") == "1":
        return None
    for key, count in (("DewarpDataK6", 12), ("DewarpData", 9)):
        given = _numbers(xmp.get(key, "").rpartition(";")[2])
        if len(given) != count or min(given[:2]) <= 0:
            continue
        fx, fy, cx, cy = (value * facts.reduction for value in given[:4])
        if not _may_be(fx, facts):
            continue
        k1, k2, p1, p2, k3, *more = given[4:]
        k4, k5, k6 = more or (0.0,) * 3
        cy = -cy if facts.model.lower() in CY_UPWARDS else cy
        lens = from_pinhole(
            Pinhole(facts.size_px, fx, fy, middle[0] + cx, middle[1] + cy, k1, k2, k3, p1, p2, k4, k5, k6),
            name,
            facts.name,
        )
        source = f"{key} of its maker"
        return StatedCamera(replace(lens, stated_by=source), source, MEASURED)
    return None


def _numbers(text: str) -> list[float]:
    """Numbers of a list with commas; none where one is not finite."""
    values = [float(number) for number in re.findall(r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?", text)]
    return values if np.isfinite(values).all() else []


def group_cameras(facts: Sequence[ImageFacts]) -> tuple[tuple[str, ...], Integers]:
    """Tell which images were taken by the same camera with the same lens."""
    keys: dict[tuple[object, ...], int] = {}
    names: list[str] = []
    members = np.zeros(len(facts), dtype=np.int64)
    for k, image in enumerate(facts):
        focal = -1.0 if math.isnan(image.focal_mm) else image.focal_mm
        band = image.maker_camera.get("RigCameraIndex", "")
        key = (image.make, image.model, image.serial, focal, image.size_px, band)
        if key not in keys:
            keys[key] = len(keys)
            plain = re.sub(r"[^A-Za-z0-9]+", "-", image.model or image.make or "camera").strip("-").lower()
            name = plain or "camera"
            names.append(name if name not in names else f"{name}-{len(names) + 1}")
        members[k] = keys[key]
    return tuple(names), members


def with_lens(facts: ImageFacts, c_px: float = 0.0, focal_mm: float = 0.0) -> ImageFacts:
    """Give what an image states, with what a person says of the lens; 0 where nothing is said."""
    if c_px > 0:
        return replace(facts, c_px=c_px, maker_camera={})
    if focal_mm > 0:
        longer = facts.focal_35mm * focal_mm / facts.focal_mm
        return replace(facts, focal_mm=focal_mm, focal_35mm=longer, maker_camera={})
    return facts


def principal_distance_px(facts: ImageFacts) -> tuple[float, str]:
    """Principal distance to start from."""
    longer = max(facts.frame_px)
    if math.isfinite(facts.c_px):
        return facts.c_px, "given"
    equivalent = _equivalents_px(facts)[0]
    model = facts.model.strip().lower()
    width = _sensor_table("width_mm").get(model, math.nan)
    thermal = _sensor_table("thermal_pitch_mm").get(
        f"{model} {facts.size_px[0]}x{facts.size_px[1]}", math.nan
    )
    for c, source in (
        (facts.focal_mm / thermal, "EXIF focal length and the known pitch of the thermal sensor"),
        (facts.focal_mm / facts.pitch_mm, "EXIF focal length and FocalPlane tags"),
        (facts.focal_mm / width * longer, "EXIF focal length and the known width of the sensor"),
    ):
        if _may_be(c, facts):
            return c, source
    if math.isfinite(facts.focal_35mm) and 5 <= facts.focal_35mm <= 2000:
        return equivalent, "EXIF focal length, 35 mm equivalent"
    return longer * UNKNOWN_WIDTHS, "assumed (60 degrees along the longer side)"


def _may_be(c: float, facts: ImageFacts) -> bool:
    """Whether a principal distance, px, may be that of a picture.

    Tags of pictures that were made smaller may be of the larger ones.
    """
    likely = LEAST_WIDTHS < c / max(facts.frame_px) < MOST_WIDTHS
    return likely and not abs(math.log(c / _equivalents_px(facts)[0])) > UNLIKE


def _equivalents_px(facts: ImageFacts) -> tuple[float, float]:
    """Principal distance by the 35 mm equivalent of the diagonal, and of the longer side."""
    diagonal = math.hypot(*facts.frame_px) / FRAME_DIAGONAL_MM
    return facts.focal_35mm * diagonal, facts.focal_35mm * max(facts.frame_px) / FRAME_WIDTH_MM


@cache
def _sensor_table(name: str) -> dict[str, float]:
    """A table of known sensors by EXIF model in lower case."""
    text = resources.files("photocal.block").joinpath("sensors.toml").read_text("utf-8")
    table: dict[str, float] = tomllib.loads(text)[name]
    return table


def start_camera(name: str, facts: ImageFacts, c: float, estimate: tuple[str, ...]) -> Camera:
    """Make a camera in px that is estimated on the job."""
    return camera(
        name, "brown-ideal", "px", facts.size_px, (1.0, 1.0), {"c": c}, estimate=estimate, affinity="after"
    )


CODE = "maker-tag"


def tag_finding(camera: Camera) -> Finding | None:
    """Say by how much the tag that a camera came with is wrong in a corner; None where it is not shown to be.

    A maker's calibration is a prior: what contradicts it says something about the tag, not that the camera
    has changed.
    """
    if not camera.stated_by or camera.given is None or camera.sigma is None:
        return None
    # A flat flight leaves c open, and all else is known: then the tag is compared at the c that was found.
    for names in (camera.free, tuple(name for name in camera.free if name != "c")):
        px, sigma_px = _at_worst_corner(camera, names)
        if px < policy.small_px or not px >= policy.times_999 * sigma_px:
            continue
        moved = np.abs(camera.values - camera.given)
        wrong = tuple(n for n in names if moved[PARAMETERS.index(n)] > policy.times_999 * camera.sigma_of(n))
        figures = {"camera": camera.id, "tag": camera.stated_by, "px": px, "sigma_px": sigma_px}
        return Finding(CODE, "note", camera.id, {**figures, "names": wrong or names})
    return None


def _at_worst_corner(camera: Camera, names: Sequence[str]) -> tuple[float, float]:
    """Where it is largest, distance of the tag in these terms from the adjusted camera, and its sigma, px."""
    corners = 0.5 * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
    corners *= np.array(camera.size_px) * camera.pitch
    rays = undistorted(camera, corners) / camera.value("c")
    q = np.column_stack([rays, np.full(len(rays), -1.0)])
    stated = np.array([name in names for name in PARAMETERS]) | ~camera.estimated
    values = camera.values if camera.given is None else np.where(stated, camera.given, camera.values)
    apart = projected(camera.with_values(values), q) - corners
    size = np.linalg.norm(apart, axis=1)
    if not np.isfinite(size).any() or not names:
        return 0.0, np.inf
    worst = int(np.nanargmax(size))
    spread = _sigma_along(camera, q, apart, names)
    return float(size[worst] / camera.pitch[0]), float(spread[worst] / camera.pitch[0])


def _sigma_along(camera: Camera, q: Floats, apart: Floats, names: Sequence[str]) -> Floats:
    """Standard deviations of where the adjusted camera records rays, along what it is apart by (n,)."""
    way = apart / np.maximum(np.linalg.norm(apart, axis=1), 1e-300)[:, None]
    covariance = camera.covariance_of(names)
    slopes = np.empty((len(q), len(names)))
    # Step of a derivative, in standard deviations.
    step_sigmas = 0.1
    for j, name in enumerate(names):
        step = step_sigmas * camera.sigma_of(name)
        ahead, behind = (
            projected(camera.changed(**{name: camera.value(name) + sign * step}), q) for sign in (1.0, -1.0)
        )
        slopes[:, j] = np.einsum("ni,ni->n", ahead - behind, way) / max(2.0 * step, 1e-300)
    return np.asarray(np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", slopes, covariance, slopes), 0.0)))


# More heads than this are no frame but a count of pictures; fewer exposures show no pattern; a head misses a
# few exposures only; pictures of one exposure are this close in time, s, and in place, m.
MOST_HEADS, FEWEST_EXPOSURES, MISSED, TOGETHER_S, TOGETHER_M = 12, 2, 0.5, 3.0, 10.0
_PARTS = re.compile(r"[_\-. ]+")
Keys = dict[Path, tuple[str, str]]


@dataclass(frozen=True)
class HeadGroup:
    """Pictures of several cameras that expose together.

    heads: names of the heads, the one that the others refer to first.
    head, exposure: of each picture, by its path; pictures that belong to none are missing.
    by: what tells it: "names" or "folders".
    """

    heads: tuple[str, ...]
    head: Mapping[Path, str]
    exposure: Mapping[Path, str]
    by: str


def recognised_heads(pictures: Mapping[Path, ImageFacts]) -> HeadGroup | None:
    """Recognise pictures of cameras on one frame; None where each picture stands for itself."""
    for by, split in (("names", _by_name), ("folders", _by_folder)):
        if frames := list(split(pictures, by)):
            return max(frames, key=lambda frame: len(frame.head))
    return None


def _by_name(pictures: Mapping[Path, ImageFacts], by: str) -> Iterable[HeadGroup]:
    """One part of the names tells the heads, the others the exposure."""
    for at in (-1, 0, -2):
        keys: Keys = {}
        for path in pictures:
            parts = _PARTS.split(path.stem)
            if len(parts) >= max(2, abs(at)):
                head = parts[at]
                keys[path] = head, "_".join(part for k, part in enumerate(parts) if k != at % len(parts))
        yield from _frame(pictures, keys, by)


def _by_folder(pictures: Mapping[Path, ImageFacts], by: str) -> Iterable[HeadGroup]:
    """Folders with equally many pictures hold a head each, and the pictures follow in their order."""
    folders = defaultdict[Path, list[Path]](list)
    for path in sorted(pictures):
        folders[path.parent].append(path)
    counts = {len(paths) for paths in folders.values()}
    names = [folder.name for folder in folders]
    if len(counts) == 1 and len(set(names)) == len(names) > 1:
        keys = {
            path: (folder.name, f"{k:05}")
            for folder, paths in folders.items()
            for k, path in enumerate(paths, start=1)
        }
        yield from _frame(pictures, keys, by)


def _frame(pictures: Mapping[Path, ImageFacts], keys: Keys, by: str) -> Iterable[HeadGroup]:
    """Give the frame of a division into heads and exposures, if it is one."""
    heads = Counter(head for head, _ in keys.values())
    exposures = defaultdict[str, list[Path]](list)
    for path, (_, exposure) in keys.items():
        exposures[exposure].append(path)
    shared = {name: paths for name, paths in exposures.items() if len(paths) > 1}
    often = [head for head, count in heads.items() if count >= MISSED * len(exposures)]
    if not (1 < len(often) <= MOST_HEADS) or len(shared) < max(FEWEST_EXPOSURES, MISSED * len(exposures)):
        return
    head = {path: name for path, (name, _) in keys.items() if name in often}
    for name in often:
        # A head is one camera.
        if len({_camera_key(pictures[path]) for path, other in head.items() if other == name}) > 1:
            return
    first = {name: next(pictures[path] for path, other in head.items() if other == name) for name in often}
    if any(_is_copy(one, other) for one, other in combinations(first.values(), 2)):
        return
    # Pictures are read by their names; those of one name but for the ending are copies in another format.
    if len({path.stem for path in head}) < len(head):
        return
    groups = [[pictures[path] for path in paths] for paths in shared.values()]
    apart = [away for group in groups if np.isfinite(away := _apart_m(group))]
    # Two flights of one camera may have the same times, or none; few exposures have a wrong position.
    if apart and np.median(apart) > TOGETHER_M:
        return
    if all(map(_together, groups)):
        order = sorted(often, key=lambda name: _rank(name, head, pictures))
        yield HeadGroup(tuple(order), head, {path: keys[path][1] for path in head}, by)


def _camera_key(facts: ImageFacts) -> tuple[object, ...]:
    return facts.make, facts.model, facts.size_px, facts.maker_camera.get("RigCameraIndex", "")


def _is_copy(one: ImageFacts, other: ImageFacts) -> bool:
    """Whether pictures of one camera differ in their size alone, or one is edited: that is a copy."""
    cameras = [(f.make, f.model, f.serial, f"{f.focal_mm}", _camera_key(f)[-1]) for f in (one, other)]
    (width, height), (other_width, other_height) = one.size_px, other.size_px
    # A pixel of rounding.
    alike = abs(width * other_height - height * other_width) <= max(width, other_width)
    scaled = alike and width != other_width
    return cameras[0] == cameras[1] and (scaled or is_edited(one) != is_edited(other))


def _together(facts: Sequence[ImageFacts]) -> bool:
    """Whether pictures were taken at one time; without times they may have been."""
    stated = [image.maker_camera for image in facts]
    captures = {tags[key] for tags in stated for key in ("CaptureUUID", "CaptureId") if key in tags}
    times = [datetime.fromisoformat(image.taken).timestamp() for image in facts if image.taken]
    return len(captures) < 2 and (not times or max(times) - min(times) < TOGETHER_S)


def _apart_m(facts: Sequence[ImageFacts]) -> float:
    """How far the first of some pictures was taken from the farthest other one; NaN without positions."""
    latitude, longitude = np.transpose([(image.latitude_deg, image.longitude_deg) for image in facts])
    east, north, _ = enu_offsets(
        latitude, longitude, np.zeros(len(facts)), np.array([latitude[0], longitude[0], 0.0])
    ).T
    return float(np.max(np.hypot(east, north)))


def _rank(name: str, head: Mapping[Path, str], pictures: Mapping[Path, ImageFacts]) -> tuple[int, str]:
    """The head that its maker numbers 0 comes first, then by number and name."""
    first = next(path for path, other in head.items() if other == name)
    index = pictures[first].maker_camera.get("RigCameraIndex", "")
    return (int(index) if index.isdigit() else MOST_HEADS), name
