"""Can these figures of a calibration be what they claim to be? Checks before anything is printed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from photocal.analysis.correlation import correlation_findings
from photocal.base.arrays import Floats
from photocal.base.policy import policy
from photocal.findings.finding import Finding

Triple = tuple[float, float, float]

FOCAL_TOLERANCE = 0.10
PRIOR_SHARE = 0.95
RADIAL = ("K1", "K2", "K3", "K4")


@dataclass(frozen=True)
class Offsets:
    """Three components of a lever arm or boresight with standard deviations, in one unit.

    values, sigmas: X, Y, Z (or omega, phi, kappa).
    prior_sigma: standard deviation of the value it was held to beforehand.
    """

    values: Triple
    sigmas: Triple
    prior_sigma: float | None = None


@dataclass(frozen=True)
class CalibrationRecord:
    """A calibration as it is printed; what is None is not stated.

    unit: the unit that c, x0, y0 are said to be in.
    values, sigmas: parameters and standard deviations by name (c, x0, y0, K1 ...).
    coefficients: whether the distortion is a polynomial of coordinates in `unit`, or of coordinates divided
        by c.
    direction: whether it is evaluated at the measured coordinates (and taken off) or at the ideal ones (and
        added).
    names, correlation: correlation matrix, shape (n, n), of the named parameters.
    correlation_rounding: half a unit of the last printed decimal of the correlations; 0 for computed ones.
    reference_radius: R0 of a balanced polynomial, in the unit of its coordinates.
    size_px: width and height.
    observed_radius: largest distance of an observation from the principal point, in `unit`; the corner if not
        stated.
    pitch_mm: size of a pixel, the mean of its sides.
    pitch_ratio: its width over its height.
    sensor_mm: width and height of the sensor, or one dimension (a side or the diagonal).
    nominal_focal_mm, height_m, gsd_cm, base_m, forward_overlap: focal length by the maker, height over
        ground, ground sampling distance, air base, share of overlap.
    convergence_deg, depth_spread: largest angle between two optical axes; spread of the camera-object
        distances over their median.
    stated_sigma_c: standard deviation of c that the client gets, where that is not the formal one.
    prior_sigmas: standard deviations of values that were observations too, by parameter.
    lever_arm_cm, boresight_deg: offsets of the positioning system.
    """

    unit: Literal["mm", "px"]
    values: Mapping[str, float]
    sigmas: Mapping[str, float]
    coefficients: Literal["plane", "normalised"] = "plane"
    direction: Literal["observed", "ideal"] = "observed"
    names: tuple[str, ...] = ()
    correlation: Floats | None = None
    correlation_rounding: float = 0.0
    reference_radius: float = 0.0
    size_px: tuple[int, int] | None = None
    observed_radius: float | None = None
    pitch_mm: float | None = None
    pitch_ratio: float = 1.0
    sensor_mm: tuple[float, ...] | None = None
    nominal_focal_mm: float | None = None
    height_m: float | None = None
    gsd_cm: float | None = None
    base_m: float | None = None
    forward_overlap: float | None = None
    convergence_deg: float | None = None
    depth_spread: float | None = None
    stated_sigma_c: float | None = None
    prior_sigmas: Mapping[str, float] = field(default_factory=dict)
    lever_arm_cm: Offsets | None = None
    boresight_deg: Offsets | None = None


def plausibility(record: CalibrationRecord) -> tuple[Finding, ...]:
    """Check a calibration for contradictions with itself."""
    wrong = [name for name, sigma in record.sigmas.items() if not (np.isfinite(sigma) and sigma >= 0.0)]
    wrong += [name for name, value in record.values.items() if not np.isfinite(value)]
    findings = [
        *correlation_findings(record.names, record.correlation, record.correlation_rounding),
        *(Finding("not_a_number", "refused", name) for name in wrong),
        *_units(record),
        *_format(record),
        *_folding(record),
        *_ground(record),
        *_base(record),
        *_weakness(record),
        *(
            Finding("not_significant", "note", name, {"t": value / sigma})
            for name, value in record.values.items()
            if name != "c" and abs(value) < policy.times_95 * (sigma := record.sigmas.get(name, 0.0))
        ),
        *(
            Finding("only_its_prior", "doubtful", name, {"sigma": record.sigmas[name], "prior_sigma": prior})
            for name, prior in record.prior_sigmas.items()
            if record.sigmas.get(name, 0.0) >= PRIOR_SHARE * prior > 0.0
        ),
        *_offsets("lever_arm", record.lever_arm_cm),
        *_offsets("boresight", record.boresight_deg),
    ]
    order = {"refused": 0, "doubtful": 1, "note": 2}
    return tuple(sorted(findings, key=lambda finding: order[finding.severity]))


def effective_unit(record: CalibrationRecord) -> Literal["mm", "px"]:
    """Give the unit that the principal distance must be in, by the focal length of the maker."""
    nominal, c = record.nominal_focal_mm, record.values["c"]
    if nominal is None or _close(c, nominal, FOCAL_TOLERANCE):
        return record.unit
    # A principal distance in pixels is the focal length over a pitch between 0.5 and 30 micrometres.
    return "px" if 5e-4 <= nominal / c <= 0.03 else record.unit


def _close(value: float, expected: float, tolerance: float) -> bool:
    return abs(value - expected) <= tolerance * abs(expected)


def _units(record: CalibrationRecord) -> list[Finding]:
    nominal, c = record.nominal_focal_mm, record.values["c"]
    if nominal is None:
        return []
    unit = effective_unit(record)
    if unit != record.unit:
        figures = {"c": c, "nominal_mm": nominal, "implied_pitch_um": 1e3 * nominal / c}
        return [Finding("px_printed_as_mm", "refused", "c", figures)]
    millimetres = c if unit == "mm" else c * record.pitch_mm if record.pitch_mm else None
    if millimetres is None or _close(millimetres, nominal, FOCAL_TOLERANCE):
        return []
    return [Finding("focal_length_differs", "doubtful", "c", {"c_mm": millimetres, "nominal_mm": nominal})]


def _format(record: CalibrationRecord) -> list[Finding]:
    findings = []
    # Sides of a pixel that differ by more than this come from rounded dimensions of the frame, not from a
    # sensor.
    square_tolerance = 1e-4
    if abs(record.pitch_ratio - 1.0) > square_tolerance:
        figures = {"percent": 100.0 * abs(record.pitch_ratio - 1.0)}
        findings.append(Finding("pitch_not_square", "doubtful", "pitch", figures))
    if record.size_px is None or record.pitch_mm is None:
        return findings
    width, height = (n * record.pitch_mm for n in record.size_px)
    if record.sensor_mm is not None and not _fits(record.sensor_mm, width, height):
        figures = {"width_mm": width, "height_mm": height, "sensor_mm": max(record.sensor_mm)}
        findings.append(Finding("pitch_contradicts_sensor", "refused", "pitch", figures))
    nominal = record.nominal_focal_mm
    if nominal is not None and effective_unit(record) == "px":
        implied = nominal / record.values["c"]
        if not _close(implied, record.pitch_mm, FOCAL_TOLERANCE):
            figures = {"pitch_um": 1e3 * record.pitch_mm, "implied_um": 1e3 * implied}
            findings.append(Finding("pitch_contradicts_focal_length", "refused", "pitch", figures))
    return findings


def _fits(sensor: tuple[float, ...], width: float, height: float) -> bool:
    # Makers round the sides of a sensor to a tenth of a millimetre.
    sensor_tolerance = 0.05
    if len(sensor) > 1:
        return _close(width, sensor[0], sensor_tolerance) and _close(height, sensor[1], sensor_tolerance)
    return any(_close(side, sensor[0], sensor_tolerance) for side in (width, height, np.hypot(width, height)))


def _folding(record: CalibrationRecord) -> list[Finding]:
    """The radius must grow in the mapping up to the farthest corner, or two places become one."""
    if record.size_px is None:
        return []
    unit = effective_unit(record)
    if unit == "mm" and record.pitch_mm is None:
        return []
    pitch = 1.0 if unit == "px" else float(record.pitch_mm or 1.0)
    half = np.array(record.size_px) * pitch / 2
    offset = np.abs([record.values.get("x0", 0.0), record.values.get("y0", 0.0)])
    corner = float(np.hypot(*(half + offset)))
    r = np.linspace(0.0, corner, 2001)
    scaled = r / record.values["c"] if record.coefficients == "normalised" else r
    k = np.array([record.values.get(name, 0.0) for name in RADIAL])
    powers = np.arange(2, 2 * len(RADIAL) + 1, 2)
    slope = (scaled[:, None] ** powers * (powers + 1) - record.reference_radius**powers) @ k
    slope = 1.0 + slope if record.direction == "ideal" else 1.0 - slope
    if slope.min() > 0.0:
        return []
    figures = {"radius": float(r[np.argmax(slope <= 0.0)]), "corner": corner, "slope": float(slope.min())}
    if record.observed_radius is not None and figures["radius"] > record.observed_radius:
        return [Finding("distortion_folds_outside", "doubtful", "K", figures)]
    return [Finding("distortion_folds", "refused", "K", figures)]


def _ground(record: CalibrationRecord) -> list[Finding]:
    if record.height_m is None or record.gsd_cm is None:
        return []
    c = record.values["c"]
    if effective_unit(record) == "px":
        expected = 100.0 * record.height_m / c
    elif record.pitch_mm is not None:
        expected = 100.0 * record.height_m * record.pitch_mm / c
    else:
        return []
    gsd_tolerance = 0.05
    if _close(record.gsd_cm, expected, gsd_tolerance):
        return []
    figures = {"gsd_cm": record.gsd_cm, "expected_cm": expected}
    return [Finding("gsd_contradicts_height", "doubtful", "gsd", figures)]


def _base(record: CalibrationRecord) -> list[Finding]:
    if record.base_m is None or record.gsd_cm is None or record.size_px is None:
        return []
    # The footprint along the flight is that of one of the two sides, most often the shorter.
    overlaps = [1.0 - record.base_m / (n * record.gsd_cm / 100.0) for n in record.size_px]
    figures = {"base_m": record.base_m, "overlap": max(overlaps)}
    if record.forward_overlap is not None:
        overlap_tolerance = 0.10
        wrong = all(abs(o - record.forward_overlap) > overlap_tolerance for o in overlaps)
    else:
        wrong = max(overlaps) < 0.5
    return [Finding("base_contradicts_overlap", "doubtful", "base", figures)] if wrong else []


def _weakness(record: CalibrationRecord) -> list[Finding]:
    """Find a principal distance that the network hardly tells from the distance of the object."""
    sigma = record.sigmas.get("c", 0.0) if record.stated_sigma_c is None else record.stated_sigma_c
    share = sigma / record.values["c"]
    if share <= policy.weak_c:
        return []
    figures = {"percent": 100.0 * share}
    if record.convergence_deg is None or record.depth_spread is None:
        return [Finding("weak_principal_distance", "doubtful", "c", figures)]
    figures |= {"convergence_deg": record.convergence_deg, "depth_percent": 100.0 * record.depth_spread}
    return [Finding("weak_principal_distance_shape", "doubtful", "c", figures)]


def _offsets(name: str, offsets: Offsets | None) -> list[Finding]:
    if offsets is None:
        return []
    sigma = max(offsets.sigmas)
    if offsets.prior_sigma is not None:
        prior = min(offsets.sigmas) >= PRIOR_SHARE * offsets.prior_sigma
    else:
        # Nothing that was estimated comes out as exactly zero three times with the same standard deviation.
        prior = not any(offsets.values) and len(set(offsets.sigmas)) == 1
    if prior:
        figures = {"sigma": sigma, "prior_sigma": offsets.prior_sigma or sigma}
        return [Finding("only_its_prior", "doubtful", name, figures)]
    return [
        Finding("not_significant", "note", f"{name}_{axis}", {"t": value / sigma})
        for axis, value, sigma in zip("XYZ", offsets.values, offsets.sigmas, strict=True)
        if sigma > 0.0 and abs(value) < policy.times_95 * sigma
    ]
