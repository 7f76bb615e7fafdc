"""What the search found, once and in the same words by every command: causes, then what was not stated."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from scipy.special import chdtri, ndtri

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.groups import CONTROL, GroupTest
from photocal.base.arrays import Floats
from photocal.base.policy import policy
from photocal.findings.digits import with_sigma
from photocal.findings.finding import Figure, Finding, Severity, Size
from photocal.findings.harm import Asked, harmful_from, weighed
from photocal.geometry.camera import Camera
from photocal.hypotheses.adequacy import Memory
from photocal.hypotheses.causes import Cause, points_of
from photocal.hypotheses.control import SLIP_BY_CHANCE, random_errors
from photocal.hypotheses.faults import fault
from photocal.hypotheses.judged import Estimate, Hypothesis
from photocal.hypotheses.search import SystematicErrors, changed_points
from photocal.hypotheses.selection import SystematicError

# A fall of v'Pv is worth less for each unknown more: by the logarithm of the usual number of observations.
_UNKNOWN = 10.0
_BODY_AXES = ("forward", "right", "down")
# No model takes these up: what they do to c or to the points of a block withholds acceptance.
_GRAVE = ("c-drift", "rolling-shutter", "refraction", "earth-curvature")


@dataclass(frozen=True)
class Slips:
    """What coordinates were typed, to name what was done wrong with them; of nothing by default.

    of_point: typing errors that made the coordinates of a point wrong, from its error and sigma, (3,) m.
    combined_factor: metres on the map that make one on the ground, of the frame; NaN where it is no map.
    """

    of_point: Callable[[str, Floats, Floats], tuple[str, ...]] = lambda *_: ()
    combined_factor: float = math.nan


no_slips = Slips()


def cause_findings(
    found: SystematicErrors, slips: Slips = no_slips, target_m: float | None = None
) -> tuple[Finding, ...]:
    """Give the causes that were found, the gravest first, and what is reported of the observations.

    target_m: root mean square error that is asked of the block; it says what is harmful.
    """
    listed = list[Finding]()
    if found.adequate:
        listed += [_beside_points(stated_sigma(group), found) for group in found.sigmas]
        listed += named(found, slips)
    else:
        listed += [_of_model(found, error) for error in found.errors if _is_field(error)]
        listed.append(_unexplained(found))
    asked = asked_of(found.first, target_m)
    return (*(weighed(one, asked) for one in listed), *_of_rays(found), *_of_memory(found))


def asked_of(fitted: AdjustedNetwork, target_m: float | None = None) -> Asked:
    """Give what a block is asked for, and its distance, speed and c, as its adjustment has them."""
    rays, state, camera = fitted.network.rays, fitted.state, fitted.network.cameras[0]
    c = float(fitted.solution.cameras[0, 0])
    distance = float(np.mean(np.linalg.norm(state.points[rays.point] - state.centre[rays.image], axis=1)))
    flown = np.linalg.norm(fitted.network.positions.velocity, axis=1)
    speed = float(np.median(flown)) if len(flown) else 0.0
    return Asked(harmful_from(min(camera.pitch) / c * distance, target_m), distance, speed, c)


def stated_sigma(group: GroupTest) -> Finding:
    """Name standard deviations that are wrong by a factor: too large ones only cost precision."""
    figures = {"group": group.name, "factor": group.factor, "lower": group.lower, "upper": group.upper}
    size = Size(group.factor, "1")
    if group.factor > 1.0:
        severity: Severity = "doubtful" if group.factor > policy.small_ratio else "note"
        return Finding("sigmas-too-small", severity, group.name, figures, size=size)
    return Finding("sigmas-too-large", "note", group.name, figures, size=size)


def _beside_points(sigma: Finding, found: SystematicErrors) -> Finding:
    """Sigmas of control that points which are wrong explain as well."""
    rival = found.undecided
    if rival is None or sigma.subject not in CONTROL:
        return sigma
    points = tuple(found.first.network.point_names[j] for j in rival.points)
    of_points = {"points": points, "off_m": float(np.abs(rival.error).max())}
    figures = {**sigma.figures, "same": ("control-mistyped",), **of_points}
    return replace(sigma, figures=figures, clauses=(*sigma.clauses, "same"), remedy="points-or-sigmas")


def named(found: SystematicErrors, slips: Slips = no_slips) -> list[Finding]:
    """Name the causes; beside large ones small ones are no causes yet, for the equations are linear."""
    if not found.errors:
        return []
    gravest = max(found.errors, key=lambda error: error.hypothesis.gain)
    limit = policy.minor_gain * gravest.hypothesis.gain
    minor = tuple(dict.fromkeys(e.hypothesis.name for e in found.errors if e.hypothesis.gain < limit))
    listed = list[Finding]()
    for error in found.errors:
        if error.hypothesis.gain < limit:
            continue
        told = _named(found, error, slips)
        told = [replace(one, figures={**one.figures, **_judged(found, error)}) for one in told]
        if minor and error is gravest:
            first = told[0]
            figures = {**first.figures, "minor": minor}
            told[0] = replace(first, figures=figures, clauses=(*first.clauses, "left-over"))
        listed += told
    return listed


def _judged(found: SystematicErrors, error: SystematicError) -> dict[str, Figure]:
    """Figures by which the harm of a cause is judged."""
    tested = error.hypothesis
    moved = changed_points(found)
    return {
        "fall": fall_of(tested),
        "gain": tested.gain,
        "unknowns": float(tested.unknowns),
        "p": tested.p_value,
        "share": error.share,
        "moved_plane_m": float(np.hypot(*moved[:2])),
        "moved_height_m": float(moved[2]),
        "on_c": tested.on_c,
        "change_of_c": max(tested.change_of_c, key=abs, default=0.0),
    }


def fall_of(tested: Hypothesis) -> float:
    """Fall of v'Pv, less what unknowns gain: of a shift, a height alone is one and two are chance."""
    known = fault(tested.name)
    of_block = known is not None and known.each == "block"
    significant = sum(estimate.significant for estimate in tested.estimates)
    needed = max(significant if of_block else tested.unknowns, 1)
    return tested.gain - _UNKNOWN * (needed - 1) - (tested.unknowns - needed)


def _is_field(error: SystematicError) -> bool:
    return error.cause is not None and error.cause.fault.each == "field"


def _named(found: SystematicErrors, error: SystematicError, slips: Slips) -> list[Finding]:
    """Name the mistake that a cause looks like; else the cause itself."""
    cause, tested = error.cause, error.hypothesis
    if _is_field(error):
        return [_of_model(found, error)]
    if cause is not None and cause.fault.each == "pair":
        return [_exchanged(found, cause)]
    if cause is not None and cause.fault.each == "point":
        return _mistyped(found, error, cause, slips)
    if cause is not None and cause.trend is not None:
        return [_scale(error, cause.trend, slips.combined_factor)]
    if tested.name == "strip-position":
        return [_strip(found, error)]
    if tested.name == "position-contradicts":
        size = _largest(tested.estimates)
        figures: dict[str, Figure] = {"numbers": _by_axis(tested.estimates), "same": error.same}
        return [Finding(tested.name, "doubtful", tested.subject, figures, _rivals(error), size)]
    special = _shift(error) if fault(tested.name) and "datum-shift" in _family(tested.name) else None
    if tested.name == "lever-arm":
        special = swapped_axes(tested.estimates)
    return [special or _systematic(error)]


def _family(code: str) -> tuple[str, str]:
    known = fault(code)
    return code, known.kind_of if known else ""


def _rivals(error: SystematicError) -> tuple[str, ...]:
    return ("same",) * bool(error.same)


def estimate_text(estimate: Estimate) -> str:
    """Write one estimate with its standard deviation, without words."""
    corrected = with_sigma(estimate.correction, estimate.sigma, "+")
    return f"{estimate.name} {corrected} {estimate.unit} (t {estimate.t:.1f})"


def _largest(estimates: tuple[Estimate, ...]) -> Size | None:
    if not estimates:
        return None
    worst = max(estimates, key=lambda estimate: abs(estimate.correction))
    return Size(worst.correction, worst.unit, worst.sigma)


def _by_axis(estimates: tuple[Estimate, ...]) -> tuple[str, ...]:
    return tuple(f"{e.name[0]} {e.correction:+.3f} +- {e.sigma:.3f} m" for e in estimates)


def _systematic(error: SystematicError) -> Finding:
    tested = error.hypothesis
    shown = [e for e in tested.estimates if e.significant] or list(tested.estimates)
    figures: dict[str, Figure] = {"numbers": tuple(estimate_text(e) for e in shown), "same": error.same}
    clauses = ("correction", *_rivals(error))
    return Finding(tested.name, "grave", figures=figures, clauses=clauses, size=_largest(tuple(shown)))


def _shift(error: SystematicError) -> Finding | None:
    """A shift common to all positions: of the height alone, or of the base."""
    axes = {estimate.name.removeprefix("shift_"): estimate for estimate in error.hypothesis.estimates}
    noteworthy = {
        axis for axis, e in axes.items() if e.significant and abs(e.correction) > policy.other_place_m
    }
    if noteworthy == {"z"}:
        z = axes["z"]
        side = "above" if z.correction > 0 else "below"
        figures: dict[str, Figure] = {"shift_m": abs(z.correction), "sigma_m": z.sigma, "side": side}
        figures["same"] = error.same
        size = Size(z.correction, "m", z.sigma)
        return Finding("antenna-height", "grave", figures=figures, clauses=_rivals(error), size=size)
    # What explains as much as a shift in plane leaves no mistake of the base alone.
    if not noteworthy or error.alternatives:
        return None
    shift = tuple(f"{axis.upper()} {e.correction:+.3f} +- {e.sigma:.3f}" for axis, e in axes.items())
    return Finding(
        "base-position",
        "grave",
        figures={"numbers": shift},
        clauses=("against-control",),
        size=_largest(error.hypothesis.estimates),
    )


def swapped_axes(estimates: tuple[Estimate, ...]) -> Finding | None:
    """A lever arm that was given with its axes in another order or with another sign.

    The exchange must agree with what was found (chi-squared of the three at 95 %), which what was given does
    not. There are 47, and some would agree with many a vector: none is named unless fewer than one in twenty
    random errors of the same axes, and about as large, would have one.
    """
    value = np.array([estimate.value for estimate in estimates])
    error = np.array([estimate.correction for estimate in estimates])
    sigma, given = np.array([estimate.sigma for estimate in estimates]), value - error
    tried = list(product(permutations(range(3)), product((1.0, -1.0), repeat=3)))
    meant = np.array([given[list(order)] * np.array(sign) for order, sign in tried])
    other = np.any(meant != given, axis=1)
    wrong = np.array([estimate.significant for estimate in estimates])
    values = np.vstack([value, given + random_errors(error, wrong)])
    away = np.sum(((meant[:, None] - values) / sigma) ** 2, axis=2)
    fits = other[:, None] & (away <= float(chdtri(3, 1.0 - policy.confidence)))
    if not fits[:, 0].any() or fits[:, 1:].any(axis=0).mean() >= SLIP_BY_CHANCE:
        return None
    # Equal or zero components make many orders the same vector: the least change is named.
    changed = [sum(order[k] != k or sign[k] < 0 for k in range(3)) for order, sign in tried]
    best = min(np.flatnonzero(fits[:, 0]).tolist(), key=lambda k: (changed[k], away[k, 0]))
    numbers, stated = (tuple(f"{v:+.3f}" for v in vector) for vector in (value, given))
    figures: dict[str, Figure] = {"stated": stated, "numbers": numbers, "changes": _changes(*tried[best])}
    size = _largest(estimates)
    return Finding("lever-arm-axes", "grave", figures=figures, clauses=("stated-and-found",), size=size)


def _changes(order: tuple[int, ...], sign: tuple[float, ...]) -> tuple[str, ...]:
    """Codes of what was exchanged and turned."""
    moved = [_BODY_AXES[k] for k in range(3) if order[k] != k]
    parts = [f"exchanged {moved[0]} {moved[1]}"] if len(moved) == 2 else ["reordered"] if moved else []
    return (*parts, *(f"opposite {_BODY_AXES[k]}" for k in range(3) if sign[k] < 0))


def _scale(error: SystematicError, trend: Floats, factor: float) -> Finding:
    """A scale of the positions against control, compared with the combined factor of a map frame."""
    (scale,) = error.hypothesis.estimates
    clauses, unsure = ["scale-of-ground"], policy.times_999 * scale.sigma
    if math.isfinite(factor):
        # Control of the ground, taken for that of the map, is too long; positions are too short against it.
        as_ground = abs(scale.correction - (factor - 1.0)) <= unsure
        as_map = abs(scale.correction - (1.0 / factor - 1.0)) <= unsure
        clauses = ["control-on-ground" if as_ground else "positions-on-ground" if as_map else "other-scale"]
    figures: dict[str, Figure] = {
        "ppm": 1e6 * scale.correction,
        "sigma_ppm": 1e6 * scale.sigma,
        "factor": factor,
        "edge_m": abs(scale.correction) * float(np.linalg.norm(trend, axis=1).max()),
        "same": error.same,
    }
    size = Size(1e6 * scale.correction, "ppm", 1e6 * scale.sigma)
    return Finding(
        "positions-scale", "grave", figures=figures, clauses=(*clauses, *_rivals(error)), size=size
    )


def _strip(found: SystematicErrors, error: SystematicError) -> Finding:
    tested, positions = error.hypothesis, found.first.network.positions
    strip = int(tested.estimates[0].name.partition("[")[2].rstrip("]"))
    axes = tuple(replace(e, name=e.name.removeprefix("shift_").upper()) for e in tested.estimates)
    figures: dict[str, Figure] = {
        "images": float(np.sum(positions.strip == strip)),
        "numbers": _by_axis(axes),
        "same": error.same,
    }
    return Finding(tested.name, "doubtful", tested.subject, figures, _rivals(error), _largest(axes))


def _mistyped(found: SystematicErrors, error: SystematicError, cause: Cause, slips: Slips) -> list[Finding]:
    """Name each control point that contradicts the others: with w, and what would have been detected."""
    away = ndtri(policy.power) - ndtri(policy.significance / 2)
    listed, rival = [], found.undecided
    rivals = ("sigmas-too-small",) * (rival is not None and rival.as_scale)
    instead = {} if rival is None else dict(zip(rival.points, rival.instead, strict=False))
    for k, point in enumerate(points_of(found.first.network, cause)):
        others = tuple(found.first.network.point_names[j] for j in instead.get(cause.members[k], ()))
        own = error.hypothesis.estimates[3 * k : 3 * k + 3]
        # Computed from the other points less given.
        d, sigma = -np.array([e.correction for e in own]), np.array([e.sigma for e in own])
        axes = zip("XYZ", d, sigma, strict=True)
        told = slips.of_point(point, d, sigma)
        figures: dict[str, Figure] = {
            "numbers": tuple(f"{axis} {v:+.3f} +- {s:.3f}" for axis, v, s in axes),
            "slips": told,
            "w": float(np.max(np.abs(d) / sigma)),
            "detectable_m": float(away * sigma.max()),
            "together": float(len(cause.members)),
            "same": rivals,
            "instead": others,
        }
        clauses = (*["same"] * bool(rivals), *["or-points"] * bool(others))
        worst = int(np.argmax(np.abs(d)))
        size = Size(float(d[worst]), "m", float(sigma[worst]))
        remedy, because = ("", "slip") if told else ("look-at-point", "")
        listed.append(
            Finding(
                *("control-mistyped", "grave", point, figures, clauses),
                size=size,
                cause=because,
                remedy=remedy,
            )
        )
    return listed


def _exchanged(found: SystematicErrors, cause: Cause) -> Finding:
    values = found.first.network.points.values[list(cause.members)]
    apart = float(np.linalg.norm(values[0] - values[1]))
    figures: dict[str, Figure] = {"points": points_of(found.first.network, cause), "apart_m": apart}
    return Finding("control-exchanged", "grave", cause.subject, figures, size=Size(apart, "m"))


def _of_model(found: SystematicErrors, error: SystematicError) -> Finding:
    """Describe a field of the image coordinates that the model of a camera lacks."""
    cause, tested, first, last = error.cause, error.hypothesis, found.first, found.last
    assert cause is not None and cause.field is not None  # noqa: S101, PT018 - of a field
    at, field, estimate = cause.field.camera, cause.field, tested.estimates[0]
    camera, c = first.network.cameras[at], float(first.solution.cameras[at, 0])
    change = -tested.change_of_c[at] if tested.change_of_c else 0.0
    sigma_c = float(np.sqrt(first.solution.camera_covariance[at, 0, 0]))
    left, share_c = _left_px(found, at), abs(change) / abs(c)
    moved = in_sigmas(first, last.solution.points - first.solution.points)
    felt = (
        abs(change) >= policy.small_sigmas * sigma_c > 0.0 and share_c >= policy.small_share
    ) or moved >= policy.small_move
    ground = ground_effect(first, at, change)
    px = abs(estimate.correction) * field.displacement / np.array(camera.pitch)
    effect = float(np.linalg.norm(px, axis=1).max(initial=0.0))
    figure, unit = _figure(cause, estimate, camera)
    fields = tuple(one for one in error.alternatives if _name_of_field(one))
    others = tuple(dict.fromkeys(one.name for one in error.alternatives if not _name_of_field(one)))
    figures: dict[str, Figure] = {
        "camera": camera.id,
        "parameter": field.parameter,
        "figure": figure,
        "sigma": estimate.sigma,
        "px": effect,
        "left_px": left,
        "f": tested.f,
        "fall": tested.gain,
        "tested": float(len(found.tested)),
        "shift_c": change,
        "unit": camera.unit,
        "ground_m": ground,
        "alike": tuple(_name_of_field(one) for one in fields),
        "same": others,
        "share": estimate.correction / c,
    }
    clauses = list[str]()
    if cause.fault.code == "rolling-shutter":
        clauses.append("read-in-ms" if field.unit == "s" else "read-in-intervals")
        figures |= {"value_ms": 1e3 * estimate.correction, "sigma_ms": 1e3 * estimate.sigma}
    if cause.fault.code == "earth-curvature":
        clauses.append("heights-in-plane" if estimate.correction > 0.0 else "curved-twice")
    if cause.fault.code == "y-scale":
        # Square pixels, scaled to a rounded format.
        ratio = camera.pitch[0] / camera.pitch[1]
        square = ratio != 1.0 and abs(1.0 + estimate.correction - ratio) < 3.0 * estimate.sigma
        clauses.append("square_pixels" if square else "stretched")
        if square:
            figures |= {"pitch_x": camera.pitch[0], "pitch_y": camera.pitch[1]}
    clauses += ["up_to", *["shifts_c"] * bool(change), *["alike"] * bool(fields), *["same"] * bool(others)]
    size = Size(figure, unit, estimate.sigma, change, ground, effect)
    small = left < policy.small_px and not felt
    severity: Severity = "note" if small else "doubtful"
    if felt and cause.fault.code in _GRAVE and found.adequate and not small:
        severity = "grave"
    return Finding(cause.fault.code, severity, camera.id, figures, (*clauses, *["small"] * small), size)


def _name_of_field(tested: Hypothesis) -> str:
    """Kind and parameter of a field, as phrases of candidates have it; empty for other causes."""
    known = fault(tested.name)
    if known is None or known.each not in ("field", "part"):
        return ""
    parameter = tested.subject.partition(" ")[2]
    kind = "c-step" if known.each == "part" else tested.name
    return f"{kind} {parameter}".strip()


def _figure(cause: Cause, estimate: Estimate, camera: Camera) -> tuple[float, str]:
    code = cause.fault.code
    if code == "y-scale":
        return 1.0 + estimate.correction, "1"
    if code == "c-drift":
        return estimate.correction, camera.unit
    units = {"rolling-shutter": cause.field.unit if cause.field else "", "shear": "1", "refraction": "1"}
    units["earth-curvature"] = "1"
    return estimate.correction, units.get(code, f"powers of {camera.unit}")


def _left_px(found: SystematicErrors, camera: int) -> float:
    """Largest displacement of a ray that no other unknown takes up, px."""
    network = found.first.network
    change = found.last.solution.residuals - found.first.solution.residuals
    change = change[(network.exposures.camera[network.rays.image] == camera) & ~found.gross]
    return float(np.linalg.norm(change / network.cameras[camera].pitch, axis=1).max(initial=0.0))


def in_sigmas(fitted: AdjustedNetwork, moved: Floats) -> float:
    """How far points move, (points, 3), in their standard deviations, root mean square."""
    sigma = np.sqrt(np.diagonal(fitted.solution.point_covariance, axis1=1, axis2=2))
    ratio = np.divide(moved, sigma, out=np.zeros_like(moved), where=sigma > 0.0)
    return float(np.sqrt(np.mean(ratio**2))) if ratio.size else 0.0


def ground_effect(fitted: AdjustedNetwork, camera: int, change_of_c: float) -> float:
    """Give the height error that a wrong c makes at the mean distance of the points of a camera."""
    rays, state = fitted.network.rays, fitted.state
    of_camera = fitted.network.exposures.camera[rays.image] == camera
    if not of_camera.any():
        return float("nan")
    apart = state.points[rays.point[of_camera]] - state.centre[rays.image[of_camera]]
    distance = np.mean(np.linalg.norm(apart, axis=1))
    return float(abs(change_of_c) / fitted.solution.cameras[camera, 0] * distance)


def _unexplained(found: SystematicErrors) -> Finding:
    """Something is left that nothing of the table explains: its candidates with their shares, none blamed."""
    best = [(error.hypothesis.name, error.share) for error in found.errors]
    shares = tuple(f"{code} {max(share, 0.0):.2f}" for code, share in best if np.isfinite(share))
    factor = float(np.sqrt(max(found.fit.factor, 0.0)))
    figures: dict[str, Figure] = {
        "factor": factor,
        "group": found.fit.groups[0] if found.fit.groups else "image",
        "shares": shares,
        "explained": found.explained if np.isfinite(found.explained) else 0.0,
        "pattern": found.fit.pattern,
    }
    clauses = ("explains-part",) if shares else ()
    # The standard deviations say nothing of what is behind so large a misfit.
    severity: Severity = "grave" if factor > policy.worth_a_word else "doubtful"
    return Finding("unexplained", severity, "", figures, clauses, Size(factor, "1"))


def _of_rays(found: SystematicErrors) -> list[Finding]:
    """Tell of gross rays that were set aside."""
    count = int(found.gross.sum())
    if not count:
        return []
    network = found.first.network
    w = np.abs(np.nan_to_num(found.first.solution.standardised(network.rays.sigma))).max(axis=1)
    worst = int(np.argmax(np.where(found.gross, w, 0.0)))
    square = np.sum((found.first.solution.residuals / network.rays.sigma) ** 2, axis=1)
    share = float(square[found.gross].sum() / max(found.first.solution.chi_squared, 1e-300))
    figures: dict[str, Figure] = {
        "n": float(count),
        "all": float(len(found.gross)),
        "w": float(w[worst]),
        "image": network.image_names[network.rays.image[worst]],
        "point": network.point_names[network.rays.point[worst]],
        "share": share,
    }
    # Gross rays that make up a larger share of v'Pv have bent what was adjusted with them.
    many = 0.1
    severity: Severity = "doubtful" if share > many else "note"
    return [Finding("gross-rays", severity, "image points", figures, size=Size(float(count), "1"))]


def _of_memory(found: SystematicErrors) -> list[Finding]:
    """Tell that positions share their errors: what they carry is less sure than independent ones make it."""
    memory: Memory | None = found.memory
    if memory is None or not memory.significant or not found.adequate:
        return []
    figures: dict[str, Figure] = {
        "correlation": memory.correlation,
        "factor": float(np.sqrt(memory.inflation)),
        "p": memory.p_value,
    }
    severity: Severity = "doubtful" if memory.exceeds else "note"
    return [
        Finding("positions-share-errors", severity, "positions", figures, size=Size(memory.correlation, "1"))
    ]
