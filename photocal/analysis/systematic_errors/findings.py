"""What a search found: worst first, each with its figure and its effect.

Findings about cameras: extra parameters, assumed sigma, bias of c, significance, stability.
"""

from dataclasses import replace

import numpy as np
from scipy import special
from scipy.sparse import csr_array

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.envelope import solve
from photocal.adjustment.factored import covariance_column
from photocal.adjustment.observations import mounting_equations
from photocal.adjustment.removed import FEWEST
from photocal.analysis.estimates import Estimates, f_test, scaled
from photocal.analysis.systematic_errors.search import (
    Search,
    VarianceComponent,
    by_navigation_fixes,
    camera_estimates,
)
from photocal.base.arrays import Floats, Integers
from photocal.base.policy import policy
from photocal.findings.finding import Figure, Finding, Severity, Size
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.geometry.distortion import projected, undistorted
from photocal.hypotheses.findings import (
    Slips,
    asked_of,
    cause_findings,
    ground_effect,
    in_sigmas,
    no_slips,
    stated_sigma,
)


def moved_with_c(fitted: AdjustedNetwork, camera: int, change: float) -> float:
    """By how many standard deviations points move when c is another and all observations are kept."""
    problem = fitted.factored.problem
    active, columns = problem.layout.camera_columns[camera]
    right = np.zeros(problem.layout.size)
    right[columns[active == 0]] = 1.0
    step, moved = covariance_column(fitted.factored, right, np.zeros_like(fitted.state.points))
    variance = float(right @ step)
    return in_sigmas(fitted, moved * (change / variance)) if variance > 0.0 else 0.0


def of_datum(search: Search) -> list[Finding]:
    """Say what depends on the datum of the positions, where no test could detect an error of it."""
    shift, solution = search.positions, search.first.solution
    if shift is None or {"datum-shift", "antenna-height"} & {e.hypothesis.name for e in search.causes.errors}:
        return []
    height = {"stated_m": float(shift.stated[2])}
    if not any(group.name == "control" for group in solution.groups):
        return [Finding("heights-on-positions", "note", "positions", height)]
    listed = []
    for k, camera in enumerate(search.first.network.cameras):
        sigma = float(np.sqrt(solution.camera_covariance[k, 0, 0]))
        by_m = float(shift.c_by_shift[k, 2])
        if not sigma > 0.0 or abs(by_m) * shift.stated[2] < policy.small_sigmas * sigma:
            continue
        by_cm: dict[str, Figure] = {
            "camera": camera.id,
            "by_cm": by_m / 100.0,
            "unit": camera.unit,
            "sigmas": abs(by_m) / 100.0 / sigma,
            "told_m": float(shift.sigma[2]),
            **height,
        }
        clause = "shift_told" if np.isfinite(shift.sigma[2]) else "shift_untold"
        listed.append(Finding("c-on-positions", "note", camera.id, by_cm, (clause,)))
    return listed


def of_sigma(search: Search) -> list[Finding]:
    """Describe the assumed standard deviation of the image coordinates, when it is wrong."""
    sigma = search.sigma
    ratio = sigma.found / sigma.assumed
    if sigma.p_value >= policy.family_significance or abs(ratio - 1.0) < policy.wrong_sigma:
        return []
    camera = search.last.network.cameras[0]
    scale, unit = (1000.0, "µm") if camera.unit == "mm" else (1.0, "px")
    # Residuals are smaller than errors: their rms is the plain figure where too much was assumed, but only
    # the one that counts the redundancy can show that too little was.
    figure = sigma.rms if ratio < 1.0 else sigma.found
    figures: dict[str, Figure] = {
        "assumed": sigma.assumed * scale,
        "found": figure * scale,
        "by_redundancy": sigma.found * scale,
        "lower": sigma.lower * scale,
        "upper": sigma.upper * scale,
        "unit": unit,
    }
    clauses = ["by_rms", "too_poor"] if ratio < 1.0 else ["by_redundancy", "too_good"]
    if ratio < 1.0 and search.corrected:
        clauses.append("unseen")
    # Too large a standard deviation costs precision and harms nothing.
    small = ratio < policy.badly_wrong_sigma
    spread = (sigma.upper - sigma.lower) / 4.0 * scale
    size = Size(figure * scale, unit, spread, 0.0, 0.0, figure / min(camera.pitch))
    severity: Severity = "note" if small else "doubtful"
    return [Finding("observation-sigma", severity, "image coordinates", figures, tuple(clauses), size)]


def of_bias(search: Search) -> list[Finding]:
    """Describe the bias of every c, when it is beyond its precision, formal and by images left out."""
    if search.last is search.first:
        return []
    listed = []
    for k, camera in enumerate(search.first.network.cameras):
        before, after = search.first.solution.cameras[k, 0], search.last.solution.cameras[k, 0]
        sigma = float(np.sqrt(search.first.solution.camera_covariance[k, 0, 0]))
        bias = float(before - after)
        cost = search.last.solution.camera_covariance[k, 0, 0] - sigma**2
        # A bias below the spread over the images is lost in it (mean square error).
        spread = float(np.nan_to_num(search.jackknife_last.standard_error[k, 0]))
        unsure = max(policy.small_sigmas * sigma, spread, policy.times_999 * np.sqrt(max(cost, 0.0)))
        if not sigma > 0.0 or abs(bias) < unsure:
            continue
        ground = ground_effect(search.first, k, bias)
        moved = in_sigmas(search.first, search.last.state.points - search.first.state.points)
        if moved < policy.small_move and abs(bias) < policy.small_share * abs(after):
            continue
        figures: dict[str, Figure] = {
            "camera": camera.id,
            "bias": bias,
            "unit": camera.unit,
            "before": float(before),
            "after": float(after),
            "formal": abs(bias) / sigma,
            "ground_m": ground,
            "share": abs(bias) / float(after),
            "moved": moved,
        }
        size = Size(bias, camera.unit, sigma, bias, ground)
        if moved < policy.small_move:
            listed.append(
                Finding("c-bias", "doubtful", camera.id, figures, ("at_this_distance", "only_carried"), size)
            )
        else:
            listed.append(Finding("c-bias", "grave", camera.id, figures, ("at_this_distance",), size=size))
    return listed


def of_significance(search: Search) -> list[Finding]:
    """Name the parameters whose significance changes with the corrections: it goes with its cause."""
    if not search.corrected:
        return []
    listed = []
    redundancy = search.last.solution.degrees_of_freedom
    for k, camera in enumerate(search.first.network.cameras):
        before, after = _honest(search.first, k), _honest(search.last, k)
        for name in before.names:
            was = f_test(before, (name,), redundancy, policy.parameter_significance)
            now = f_test(after, (name,), redundancy, policy.parameter_significance)
            if was.significant == now.significant:
                continue
            at = after.names.index(name)
            figures: dict[str, Figure] = {
                "camera": camera.id,
                "parameter": name,
                "value": float(after.values[at]),
                "sigma": float(after.sigmas[at]),
                "f": now.statistic,
                "critical": now.critical,
                "f_before": was.statistic,
            }
            clauses = ("no_longer" if was.significant else "only_then",)
            size = Size(now.statistic, f"powers of {camera.unit}")
            listed.append(Finding("significance", "note", camera.id, figures, clauses, size))
    return listed


def of_jackknife(search: Search) -> list[Finding]:
    """Describe parameters that depend on single images, and images without which nothing is determined."""
    listed = []
    for k, camera in enumerate(search.first.network.cameras):
        listed += _indispensable(search, k)
        formal = np.sqrt(np.diag(search.first.solution.camera_covariance[k])) * np.sqrt(_factor(search.first))
        before = search.jackknife_first.standard_error[k]
        ratio = np.divide(before, formal, out=np.zeros_like(before), where=formal > 0.0)
        if not np.any(ratio > policy.unstable):
            continue
        worst = 0 if ratio[0] > policy.unstable else int(np.nanargmax(ratio))
        adjusted, name = camera.with_values(search.first.state.cameras[k]), PARAMETERS[worst]
        after = search.jackknife_last.standard_error[k]
        error, corrected, usual = (
            _readable(adjusted, name, float(one[worst])) for one in (before, after, formal)
        )
        figures: dict[str, Figure] = {
            "camera": camera.id,
            "parameter": name,
            "error": error[0],
            "unit": error[1],
            "corrected": corrected[0],
            "formal": usual[0],
        }
        effect = float(before[0]) if worst == 0 else None
        clauses = ["in_corner"] if error[2] else []
        clauses.append("once_corrected" if search.corrected else "as_adjusted")
        # The larger standard deviation holds where other blocks use the parameter, not for heights of this.
        ground: float | None = None
        severity: Severity = "note"
        if effect is not None:
            ground = ground_effect(search.first, k, effect)
            moved = moved_with_c(search.first, k, effect)
            figures |= {"ground_m": ground, "moved": moved}
            clauses.append("less_sure_carried" if moved < policy.small_move else "heights_hang")
            if moved >= policy.small_move and ground >= asked_of(search.first).ground_m:
                severity = "doubtful"
        size = Size(error[0], error[1], None, effect, ground)
        listed.append(Finding("jackknife", severity, camera.id, figures, tuple(clauses), size))
    return listed


def _readable(camera: Camera, name: str, amount: float) -> tuple[float, str, bool]:
    """An amount of a parameter in a unit that can be read; of a coefficient what it moves in the corner."""
    if name == "readout":
        return 1e3 * amount, "ms", False
    if name in ("c", "x0", "y0"):
        return amount, camera.unit, False
    corner = 0.5 * np.array(camera.size_px) * camera.pitch
    ray = np.append(undistorted(camera, corner[None])[0] / camera.value("c"), -1.0)[None]
    moved = projected(camera.changed(**{name: camera.value(name) + amount}), ray) - projected(camera, ray)
    px = float(np.linalg.norm(moved)) / camera.pitch[0]
    # A lens may end before the corner.
    return (px, "px", True) if np.isfinite(px) else (amount, camera.unit, False)


def _indispensable(search: Search, k: int) -> list[Finding]:
    """Name images of a camera that no other image checks, where too few for the sandwich are left."""
    network, camera = search.first.network, search.first.network.cameras[k]
    own = [name for name, at in zip(network.image_names, network.exposures.camera, strict=True) if at == k]
    needed = [name for name in own if name in search.jackknife_first.not_possible]
    if not needed or len(own) - len(camera.free) >= FEWEST or not camera.free:
        return []
    # Where the others can be left out, another finding reports how c changes.
    unknown = bool(np.isnan(search.jackknife_first.standard_error[k, 0]))
    figures: dict[str, Figure] = {"camera": camera.id, "names": tuple(needed)}
    return [Finding("image-needed", "doubtful" if unknown else "note", camera.id, figures)]


def _factor(fitted: AdjustedNetwork) -> float:
    """Give the variance factor for judging: a posteriori, but never below 1."""
    return max(1.0, fitted.solution.variance_factor)


def _honest(fitted: AdjustedNetwork, camera: int) -> Estimates:
    return scaled(camera_estimates(fitted, camera), _factor(fitted))


def one_angle_photos(fitted: AdjustedNetwork) -> list[Finding]:
    """Name the photos whose omega and kappa are one angle, because phi is near 90 degrees."""
    # The third row of a rotation begins with the sine of phi.
    steep = np.abs(fitted.state.rotation[:, 2, 0])
    at = np.flatnonzero(steep > policy.one_angle)
    if not len(at):
        return []
    names = tuple(fitted.network.image_names[k] for k in at)
    apart = float(np.degrees(np.arccos(steep[at].max())))
    return [Finding("one-angle-photos", "note", ", ".join(names), {"images": names, "apart_deg": apart})]


# Places in the flight at which a head is tried to have moved, exposures that must lie before and after.
PLACES, FEWEST_PAIRS = 16, 3


def of_stated(search: Search) -> list[Finding]:
    """Name groups whose stated standard deviations are wrong by a factor."""
    listed = []
    for group in search.groups:
        if (
            group.p_value >= policy.family_significance / len(search.groups)
            or abs(group.factor - 1.0) < policy.wrong_sigma
        ):
            continue
        memory = search.causes.memory
        if group.factor < 1.0 and group.name == "position" and memory is not None and memory.likely:
            # Positions that share their errors look better than they are.
            continue
        # What is known beforehand is stated with caution, and so is how much an image may move while it is
        # read: no error of measurement says otherwise.
        if group.factor < 1.0 and group.name in ("camera", "mounting", "head", "rig", "motion"):
            continue
        found = stated_sigma(group)
        if group.name == "motion" or (group.name == "exposure" and by_navigation_fixes(search.first.network)):
            # Nobody states how much an image may move while it is read, or how good a navigation fix is.
            found = replace(found, severity="note")
        listed.append(replace(found, figures={**found.figures, "camera": group.of}))
    return listed


def of_groups(search: Search) -> list[Finding]:
    """Describe image axes and cameras that scatter differently."""
    overall = search.sigma.found / search.sigma.assumed
    return [
        _scatter(code, component, search)
        for code, components in (("axis-scatter", search.axes), ("camera-scatter", search.cameras))
        for component in components
        if component.p_value < policy.family_significance and component.ratio > policy.worth_a_line * overall
    ]


def of_images(search: Search) -> list[Finding]:
    """Describe images that scatter more, or have a scale or principal point of their own."""
    components = {image.name: image for image in search.images}
    sigma_px = search.sigma.found / min(search.last.network.cameras[0].pitch)
    overall = search.sigma.found / search.sigma.assumed
    listed = []
    shifts = {image_shift.image: image_shift for image_shift in search.shifts}
    for name, component in components.items():
        shift = shifts.get(name)
        shifted = (
            shift is not None
            and shift.p_value < policy.family_significance
            and shift.effect_px > policy.visible_sigmas * sigma_px
        )
        # One bad image makes the good ones look better than all together: only the bad one is named.
        scattered = component.p_value < policy.family_significance and component.ratio > overall
        if not (scattered or shifted):
            continue
        finding = _scatter("image", component, search)
        if shift is None or not shifted:
            listed.append(finding)
            continue
        small = shift.effect_px < policy.small_px
        figures = {**finding.figures, "moved_px": shift.effect_px}
        severity: Severity = "note" if small else "doubtful"
        rest = ("small",) if small else ()
        if scattered:
            size = Size(_relative(component, search), "1", px=shift.effect_px)
            listed.append(Finding("image", severity, name, figures, ("own_geometry", *rest), size))
        else:
            size = Size(shift.effect_px, "px", px=shift.effect_px)
            listed.append(Finding("image-geometry", severity, name, figures, rest, size))
    return sorted(listed, key=lambda entry: -entry.size.figure if entry.size else 0.0)


def _relative(component: VarianceComponent, search: Search) -> float:
    """Scatter of a group over that of all together."""
    return component.ratio / (search.sigma.found / search.sigma.assumed)


def _scatter(code: str, component: VarianceComponent, search: Search) -> Finding:
    relative = _relative(component, search)
    effect = component.ratio * search.sigma.assumed / min(search.last.network.cameras[0].pitch)
    small = effect < policy.small_px or relative < policy.small_ratio
    figures: dict[str, Figure] = {"name": component.name, "relative": relative, "px": effect}
    clauses = ("amount", "small") if small else ("amount",)
    size = Size(relative, "1", px=effect)
    return Finding(code, "note" if small else "doubtful", component.name, figures, clauses, size)


def of_maps(search: Search) -> list[Finding]:
    """Describe patterns of the residuals on the sensor."""
    listed = []
    for camera, cells in zip(search.last.network.cameras, search.maps, strict=True):
        if cells is None or (
            cells.global_p_value >= policy.family_significance and not cells.significant.any()
        ):
            continue
        length = np.linalg.norm(cells.mean_px, axis=-1)
        length[cells.count == 0] = 0.0
        if cells.significant.any():
            length[~cells.significant] = 0.0
        row, column = np.unravel_index(int(np.argmax(length)), length.shape)
        effect = float(length[row, column])
        small = effect < policy.small_px
        figures: dict[str, Figure] = {
            "camera": camera.id,
            "significant": float(cells.significant.sum()),
            "cells": float(cells.cells),
            "px": effect,
            "column": float(cells.columns_px[column] + cells.columns_px[column + 1]) / 2,
            "row": float(cells.rows_px[row] + cells.rows_px[row + 1]) / 2,
        }
        clauses = ("small",) if small else ()
        severity: Severity = "note" if small else "doubtful"
        size = Size(effect, "px", px=effect)
        listed.append(Finding("residual-map", severity, camera.id, figures, clauses, size))
    return listed


def of_heads(fitted: AdjustedNetwork) -> list[Finding]:
    """Name a head that moved on its frame between exposures: the likeliest head and place."""
    network, state, at = fitted.network, fitted.state, fitted.factored
    rig = network.rig
    if not len(rig.first):
        return []
    layout = at.problem.layout
    equations = mounting_equations(network, layout, state)["rig"]
    coefficients = csr_array(
        (equations.coefficient, equations.column, equations.start), (len(equations.weight), layout.size)
    )
    head, when = rig.head_of(network.exposures.camera), network.exposures.time
    # Exposures without a time stand in the order of their images.
    known = when is not None and np.isfinite(when).all()
    moment = when[rig.second] if known and when is not None else rig.second.astype(float)
    give, tried = rig.relation_sigma(network.exposures.camera), []
    for k in np.unique(head[rig.second]).tolist():
        pairs = np.flatnonzero(head[rig.second] == k)
        pairs = pairs[np.argsort(moment[pairs], kind="stable")]
        if len(pairs) < 2 * FEWEST_PAIRS:
            continue
        starts = np.unique(np.linspace(FEWEST_PAIRS, len(pairs) - FEWEST_PAIRS, PLACES).astype(np.int64))
        jumps = [_jump(pairs[start:], give, len(rig.first)) for start in starts.tolist()]
        designs = [
            np.column_stack([coefficients[own].T @ slope for own, slope in zip(*jump, strict=True)])
            for jump in jumps
        ]
        # All places at once: each solution goes through the whole factor.
        inside = np.hsplit(solve(layout.envelope, at.normal.matrix, np.hstack(designs)), len(starts))
        for start, (rows, slopes), design, follows in zip(starts, jumps, designs, inside, strict=True):
            force = np.sum(slopes * equations.residual[rows], axis=1)
            square = np.sum(slopes**2, axis=1)
            unit = np.sqrt(square / slopes.shape[1])
            normal = np.diag(square) - design.T @ follows
            # The jump in units in which the stiffness is 1: what nothing resists has no share.
            scaled = normal / np.outer(unit, unit)
            value, vector = np.linalg.eigh((scaled + scaled.T) / 2)
            good = value > 1e-9 * slopes.shape[1]
            inverse = (vector[:, good] / value[good]) @ vector[:, good].T / np.outer(unit, unit)
            move = inverse @ force
            tried.append((float(force @ move), int(good.sum()), k, int(pairs[start]), move, inverse))
    if not tried:
        return []
    # One that moves pulls at the others: the one that moved most is named.
    chi_squared, freedom, k, pair, move, inverse = max(tried, key=lambda jump: jump[0] / jump[1])
    p_value = min(1.0, len(tried) * float(special.chdtrc(freedom, chi_squared)))
    if p_value >= policy.family_significance:
        return []
    # Turns about its axes, then shifts in those of the first head.
    camera, turn = network.cameras[rig.camera[k]].id, float(np.degrees(np.linalg.norm(move[:3])))
    figures = {
        "camera": camera,
        "image": network.image_names[rig.second[pair]],
        "turn_arcsec": 3600.0 * turn,
        "shift_mm": 1000.0 * float(np.linalg.norm(move[3:])),
        "p": p_value,
    }
    size = Size(turn, "deg", float(np.degrees(np.sqrt(np.trace(inverse[:3, :3])))))
    return [Finding("head-moved", "grave", camera, figures, size=size)]


def _jump(later: Integers, give: Floats, count: int) -> tuple[Integers, Floats]:
    """Rows of the relations of some of so many pairs, (6, n): turns, then shifts; and roots of weights."""
    rows = np.array([(n // 3) * 3 * count + 3 * later + n % 3 for n in range(6)])
    return rows, 1.0 / give[later, ::-1].repeat(3, axis=1).T


def findings(search: Search, slips: Slips = no_slips) -> tuple[Finding, ...]:
    """Turn a search into a list, causes first.

    slips: what names the typing errors of a control point.
    """
    causes = cause_findings(search.causes, slips)
    listed = of_sigma(search)
    listed += of_bias(search)
    listed += of_significance(search)
    listed += of_jackknife(search)
    listed += of_stated(search)
    listed += of_groups(search)
    listed += of_heads(search.last)
    listed += of_images(search)
    listed += of_maps(search)
    told = {(finding.code, finding.subject) for finding in causes}
    listed = [finding for finding in listed if (finding.code, finding.subject) not in told]
    return tuple(sorted((*causes, *listed), key=lambda finding: finding.small))
