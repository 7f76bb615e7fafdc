"""Tests of what pictures state: focus, bodies, fixes, corrections in the camera, smear, gimbal.

What pictures tell of the conditions that they were taken under: nothing is typed twice.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from photocal.base.arrays import Floats
from photocal.findings.finding import Finding, Severity
from photocal.findings.texts import Catalogue
from photocal.geometry.smear import SMEAR_LIMIT_PX, smear_px
from photocal.measurement.image_facts import ImageFacts, camera_temperatures, is_edited
from photocal.measurement.listed_positions import PICTURE_LATE_M, PICTURE_SIGMA_M, SIGMAS
from photocal.measurement.maker_camera import stated_camera
from photocal.measurement.picture_facts import keys_of

Sections = dict[str, dict[str, str | float]]


def told_conditions(facts: Sequence[ImageFacts]) -> Sections:
    """Give what the pictures tell of their camera and its state, in sections of a certificate's particulars.

    Values that differ stand side by side, of numbers the least, the median and the largest; what no picture
    says is left out. Each says whether EXIF or XMP told it.
    """
    warm = temperatures(facts)
    conditions: dict[str, str | float] = {
        "aperture": _each(facts, "f_number", "f/{:g}"),
        "focus": _joined(
            _each(facts, "focus_m", "{:g} m"), _spread(facts, "lens_position", "lens position {}", "")
        ),
        "firmware": _each(facts, "firmware"),
        "exposure": _joined(
            _spread(facts, "exposure_s", "{}", " ms", 1e3), _spread(facts, "iso", "ISO {}", "")
        ),
        "shutter": _joined(_each(facts, "shutter_type"), _spread(facts, "shutter_count", "count {}", "")),
        "sensor_temperature": _spread(facts, "sensor_temperature_c", "{}", " °C"),
        "lens_temperature": _spread(facts, "lens_temperature_c", "{}", " °C"),
        "in_camera_correction": _correction(facts),
        "positions": _positions(facts),
    }
    if warm is not None:
        conditions["camera_temperature_c"] = warm[1]
    camera = {"model": "model", "manufacturer": "make", "serial": "serial"}
    camera |= {"lens_type": "lens", "lens_serial": "lens_serial"}
    platform = _joined(_each(facts, "vehicle"), _each(facts, "vehicle_serial"), between=" ")
    sections: Sections = {
        "camera": {key: _each(facts, name) for key, name in camera.items()},
        "campaign": {"platform": platform},
        "conditions": conditions,
    }
    kept = {name: {k: v for k, v in section.items() if v != ""} for name, section in sections.items()}
    return {name: section for name, section in kept.items() if section}


def temperatures(facts: Sequence[ImageFacts]) -> tuple[float, float, float] | None:
    """Least, median and largest temperature of the lens, else of the sensor, deg C; None for neither."""
    values = camera_temperatures(facts)
    values = values[np.isfinite(values)]
    return (float(values.min()), float(np.median(values)), float(values.max())) if len(values) else None


def _numbers(facts: Sequence[ImageFacts], name: str) -> Floats:
    values = np.array([getattr(image, name) for image in facts], dtype=float)
    return np.asarray(values[np.isfinite(values)])


def _origin(name: str) -> str:
    return "EXIF" if keys_of(name)[0].startswith("EXIF:") else "XMP"


def _each(facts: Sequence[ImageFacts], name: str, form: str = "{}") -> str:
    """Write the values of one fact of all pictures, each once."""
    given = {getattr(image, name) for image in facts}
    texts = sorted(form.format(value) for value in given if value and str(value) != "nan")
    # Beyond so many values of one fact the first and the last are named.
    named = 4
    if len(texts) > named:
        texts = [f"{texts[0]} ... {texts[-1]}"]
    return f"{', '.join(texts)} ({_origin(name)})" if texts else ""


def _spread(facts: Sequence[ImageFacts], name: str, form: str, unit: str, scale: float = 1.0) -> str:
    """Write the least, the median and the largest value of a number; one value where all are alike."""
    values = scale * _numbers(facts, name)
    if not len(values):
        return ""
    three = (values.min(), np.median(values), values.max())
    text = f"{three[0]:.4g}" if three[0] == three[2] else " / ".join(f"{value:.4g}" for value in three)
    return f"{form.format(text)}{unit} ({_origin(name)})"


def _joined(*texts: str, between: str = ", ") -> str:
    return between.join(text for text in texts if text)


def _correction(facts: Sequence[ImageFacts]) -> str:
    """Say whether the camera corrected the pictures by itself, where they tell."""
    flags = _numbers(facts, "dewarped")
    if not len(flags):
        return ""
    on = int(np.count_nonzero(flags == 1))
    return f"{'off' if not on else f'distortion removed in {on} of {len(facts)} pictures'} (XMP)"


def _positions(facts: Sequence[ImageFacts]) -> str:
    """Say how the positions were solved, how old the corrections were, and whose they are."""
    counts = Counter(image.fix for image in facts if image.fix)
    if not counts:
        return ""
    solved = ", ".join(f"{counts[fix]} {fix}" for fix in ("fixed", "float", "single") if counts[fix])
    casters = sorted({"/".join(filter(None, (i.caster, i.mount_point))) for i in facts} - {""})
    age = _spread(facts, "rtk_age_s", "corrections {}", " s old")
    return _joined(f"RTK: {solved} (XMP)", age, f"caster {', '.join(casters)} (XMP)" if casters else "")


# Positions of pictures are code fixes up to a second old: a table that is farther away is of another place.
_TABLE_APART_M = SIGMAS * PICTURE_SIGMA_M + PICTURE_LATE_M


def judge_pictures(facts: Sequence[ImageFacts]) -> list[Finding]:
    """Judge the pictures of one camera by what they state; nothing is said of what they do not state."""
    alike, findings = list(facts), list[Finding]()
    # What was taken with another body or lens is not judged by the settings of this one.
    for code, stated in (
        ("pictures-of-other-camera", _body),
        ("lens-changed", _lens),
        ("refocused", _focus),
    ):
        usual, others = _unlike(alike, stated)
        if others:
            findings.append(_about(code, others, facts, "doubtful", told=stated(others[0]), usual=usual))
            left_out = {id(image) for image in others}
            alike = [image for image in alike if id(image) not in left_out]
    for test in (_edited, _fixes, _old_corrections, _smeared, _beside_table):
        findings += test(facts)
    for code, severity, sign in _SIGNS:
        if shown := [image for image in facts if sign(image)]:
            findings.append(_about(code, shown, facts, severity))
    return findings


def _about(
    code: str,
    group: Sequence[ImageFacts],
    every: Sequence[ImageFacts],
    severity: Severity,
    **more: float | str,
) -> Finding:
    names = tuple(image.name for image in group)
    figures = {"n": float(len(names)), "all": float(len(every)), "images": names, **more}
    return Finding(code, severity, figures=figures)


def _unlike(facts: Sequence[ImageFacts], stated: Callable[[ImageFacts], str]) -> tuple[str, list[ImageFacts]]:
    """What most pictures state, and those that state something else."""
    counts = Counter(text for image in facts if (text := stated(image)))
    usual = max(counts, key=lambda text: counts[text], default="")
    own = next((image for image in facts if stated(image) == usual), None)
    others = [image for image in facts if stated(image) not in ("", usual)]
    return usual, [image for image in others if own is None or stated(_at_rest(image, own)) != usual]


def _at_rest(image: ImageFacts, usual: ImageFacts) -> ImageFacts:
    """An image whose lens stands where it usually does: a drive may come to rest a step beside."""
    if abs(image.lens_position - usual.lens_position) <= 1.0:
        return replace(image, lens_position=usual.lens_position)
    return image


def _body(image: ImageFacts) -> str:
    parts = image.make, image.model, image.serial, "x".join(map(str, image.size_px)), image.lens_serial
    return " ".join(filter(None, parts))


def _lens(image: ImageFacts) -> str:
    return f"{image.focal_mm:g} mm" if np.isfinite(image.focal_mm) else ""


def _focus(image: ImageFacts) -> str:
    """Distance and lens position, as far as they are stated."""
    told = [f"{image.focus_m:g} m"] if np.isfinite(image.focus_m) else []
    told += [f"lens position {image.lens_position:g}"] if np.isfinite(image.lens_position) else []
    return ", ".join(told)


def _edited(facts: Sequence[ImageFacts]) -> Iterator[Finding]:
    """Pictures that a program for pictures has written anew."""
    if group := [image for image in facts if is_edited(image)]:
        yield _about("pictures-edited", group, facts, "doubtful", program=group[0].firmware)


def _fixes(facts: Sequence[ImageFacts]) -> Iterator[Finding]:
    """Find positions without fixed ambiguities among fixed ones, and pictures that are not for mapping."""
    counts = Counter(image.fix for image in facts)
    without = [image for image in facts if image.fix in ("float", "single")]
    if without:
        severity: Severity = "doubtful" if counts["fixed"] else "note"
        figures = {"n_float": float(counts["float"]), "n_single": float(counts["single"])}
        yield _about("pictures-not-fixed", without, facts, severity, **figures)
    if poor := [image for image in facts if image.surveying_mode == 0 and image not in without]:
        yield _about("pictures-not-for-mapping", poor, facts, "note")


def _old_corrections(facts: Sequence[ImageFacts]) -> Iterator[Finding]:
    # Corrections of RTK that are older leave centimetres of the atmosphere in the positions (RTCM: 10 s).
    oldest_correction_s = 10.0
    old = [image for image in facts if image.rtk_age_s > oldest_correction_s and image.fix]
    if old:
        oldest = max(image.rtk_age_s for image in old)
        yield _about("corrections-old", old, facts, "doubtful", age_s=oldest, limit_s=oldest_correction_s)


def _smeared(facts: Sequence[ImageFacts]) -> Iterator[Finding]:
    """Find pictures that their flight smears while the shutter is open."""
    smears = [(smear_of(image), image) for image in facts]
    long = [(smear, image) for smear, image in smears if smear > SMEAR_LIMIT_PX]
    if long:
        most = max(smear for smear, _ in long)
        # More than this smear is no longer a loss of contrast only.
        much_smear_px = 1.0
        severity: Severity = "doubtful" if most > much_smear_px else "note"
        yield _about(
            "pictures-smeared", [image for _, image in long], facts, severity,
            smear_px=most, limit_px=SMEAR_LIMIT_PX,
        )  # fmt: skip


def smear_of(image: ImageFacts) -> float:
    """Way of the ground while the shutter was open, px; NaN where the picture does not tell."""
    distance = flying_height_m(image)
    if not distance > 0 or not np.isfinite(image.exposure_s * image.speed_m_s):
        return np.nan
    gsd = distance / stated_camera("", image).camera.value("c")
    return float(smear_px(image.exposure_s, image.speed_m_s, gsd))


def flying_height_m(image: ImageFacts) -> float:
    """Distance to the ground: by the laser, else the height above the take-off point; NaN for neither."""
    return image.laser_m if np.isfinite(image.laser_m) else image.relative_altitude_m


def _turned_over(image: ImageFacts) -> bool:
    """Whether the gimbal hangs upside down, has rolled over or looks behind nadir."""
    roll, pitch, _ = image.gimbal_deg
    # A gimbal that looks further behind than this has turned over; cameras without one swing by less.
    past_nadir_deg = 15.0
    behind = pitch < -90.0 - past_nadir_deg
    return bool(image.gimbal_reverse == 1 or image.camera_reverse == 1 or abs(roll) > 90.0 or behind)


# What a single picture shows: code, severity and sign. Of a picture whose distortion the camera took out what
# is calibrated is not the lens; a sharpness of 2 is hard (EXIF).
_SIGNS: tuple[tuple[str, Severity, Callable[[ImageFacts], bool]], ...] = (
    (
        "pictures-dewarped",
        "doubtful",
        lambda image: image.dewarped == 1 or image.lens_profile.lower() in ("1", "true"),
    ),
    ("pictures-sharpened", "note", lambda image: image.sharpness == 2),
    ("gimbal-turned-over", "note", _turned_over),
)


def _beside_table(facts: Sequence[ImageFacts]) -> Iterator[Finding]:
    """Find positions of a table that lie elsewhere than the pictures say themselves: another flight's."""
    known = [image for image in facts if np.isfinite(image.table_apart_m)]
    away = [image for image in known if image.table_apart_m > _TABLE_APART_M]
    if away:
        apart = float(np.median([image.table_apart_m for image in away]))
        yield _about("table-beside-pictures", away, facts, "doubtful", apart_m=apart)


def laser_and_temperature(facts: Sequence[ImageFacts], say: Catalogue) -> list[str]:
    """Sentences on the laser distances and temperatures that pictures state."""
    lasers = np.array([image.laser_m for image in facts])
    hit, told = lasers[np.isfinite(lasers)], list[str]()
    if len(hit):
        heights = np.array([image.relative_altitude_m for image in facts])
        heights = heights[np.isfinite(heights)]
        each = say("new.laser_each", distances=", ".join(say.fixed(distance, 1) for distance in hit))
        spread = say("new.laser_spread", **_three(hit.min(), np.median(hit), hit.max(), say))
        # So many laser distances are listed one by one.
        listed = 12
        spread = each if len(hit) <= listed else spread
        text = say("new.laser", n=len(hit), all=len(facts), distances=spread)
        if len(heights):
            text = say("new.laser_height", text=text, height=say.fixed(float(np.median(heights)), 1))
        told.append(text)
    if (warm := temperatures(facts)) is not None:
        told.append(say("new.warm", **_three(*warm, say)))
    return told


def _three(least: float, median: float, largest: float, say: Catalogue) -> dict[str, str]:
    named = {"least": least, "median": median, "largest": largest}
    return {name: say.fixed(value, 1) for name, value in named.items()}


def judge_cameras(facts: Sequence[ImageFacts], names: Sequence[str], member: Sequence[int]) -> list[Finding]:
    """Judge the pictures of each camera; `member` tells which took each picture."""
    findings = list[Finding]()
    for k, name in enumerate(names):
        own = [image for image, of in zip(facts, member, strict=True) if of == k]
        findings += [replace(finding, subject=name) for finding in judge_pictures(own)]
    return findings
