"""What pictures tell of the conditions that they were taken under: nothing is typed twice."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from photocal.base.arrays import Floats
from photocal.measurement.image_facts import ImageFacts, camera_temperatures
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
    return f"{'off' if not on else f'distortion taken out in {on} of {len(facts)} pictures'} (XMP)"


def _positions(facts: Sequence[ImageFacts]) -> str:
    """Say how the positions were solved, how old the corrections were, and whose they are."""
    counts = Counter(image.fix for image in facts if image.fix)
    if not counts:
        return ""
    solved = ", ".join(f"{counts[fix]} {fix}" for fix in ("fixed", "float", "single") if counts[fix])
    casters = sorted({"/".join(filter(None, (i.caster, i.mount_point))) for i in facts} - {""})
    age = _spread(facts, "rtk_age_s", "corrections {}", " s old")
    return _joined(f"RTK: {solved} (XMP)", age, f"caster {', '.join(casters)} (XMP)" if casters else "")
