"""What a search found: worst first, each with its figure and its effect."""

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.envelope import solve
from photocal.adjustment.observations import mounting_equations
from photocal.analysis.systematic_errors import camera_findings
from photocal.analysis.systematic_errors.scatter import VarianceComponent
from photocal.analysis.systematic_errors.search import Search
from photocal.base.policy import policy
from photocal.findings.finding import Figure, Finding, Severity, Size
from photocal.hypotheses.findings import Slips, cause_findings, no_slips

# Places in the flight at which a head is tried to have moved, exposures that must lie before and after.
PLACES, FEWEST = 16, 3


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
        # What is known beforehand is stated with caution: no error of measurement says otherwise.
        if group.factor < 1.0 and group.name in ("camera", "mounting", "head", "rig"):
            continue
        figures: dict[str, Figure] = {
            "group": group.name,
            "factor": group.factor,
            "lower": group.lower,
            "upper": group.upper,
            "camera": group.of,
        }
        size = Size(group.factor, "1")
        if group.factor > 1.0:
            severity: Severity = "doubtful" if group.factor > policy.small_ratio else "note"
            listed.append(Finding("sigmas-too-small", severity, group.name, figures, size=size))
        else:
            listed.append(Finding("sigmas-too-large", "note", group.name, figures, size=size))
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
        clauses = ("own_geometry", "small") if small else ("own_geometry",)
        size = Size(_relative(component, search), "1", px=shift.effect_px)
        listed.append(Finding("image", "note" if small else "doubtful", name, figures, clauses, size))
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
    head, when = rig.head_of(network.exposures.camera), network.exposures.time
    # Exposures without a time stand in the order of their images.
    known = when is not None and np.isfinite(when).all()
    moment = when[rig.second] if known and when is not None else rig.second.astype(float)
    give, tried = rig.give(network.exposures.camera), []
    for k in np.unique(head[rig.second]).tolist():
        pairs = np.flatnonzero(head[rig.second] == k)
        pairs = pairs[np.argsort(moment[pairs], kind="stable")]
        if len(pairs) < 2 * FEWEST:
            continue
        starts = np.unique(np.linspace(FEWEST, len(pairs) - FEWEST, PLACES).astype(np.int64))
        for start in starts.tolist():
            later = pairs[start:]
            # Rows of their relations, by component: three turns, then three shifts.
            rows = np.array([(n // 3) * 3 * len(rig.first) + 3 * later + n % 3 for n in range(6)])
            slopes = 1.0 / give[later, ::-1].repeat(3, axis=1).T
            design = np.zeros((layout.size, 6))
            force = np.zeros(6)
            for n in range(6):
                for row, slope in zip(rows[n].tolist(), slopes[n].tolist(), strict=True):
                    span = slice(equations.start[row], equations.start[row + 1])
                    np.add.at(design[:, n], equations.column[span], slope * equations.coefficient[span])
                force[n] = slopes[n] @ equations.residual[rows[n]]
            inside = solve(layout.envelope, at.normal.matrix, design)
            square = np.sum(slopes**2, axis=1)
            unit = np.sqrt(square / len(later))
            normal = np.diag(square) - design.T @ inside
            # The jump in units in which the stiffness is 1: what nothing resists has no share.
            scaled = normal / np.outer(unit, unit)
            value, vector = np.linalg.eigh((scaled + scaled.T) / 2)
            good = value > 1e-9 * len(later)
            inverse = (vector[:, good] / value[good]) @ vector[:, good].T / np.outer(unit, unit)
            move = inverse @ force
            tried.append((float(force @ move), int(good.sum()), k, int(later[0]), move, inverse))
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


def findings(search: Search, slips: Slips = no_slips) -> tuple[Finding, ...]:
    """Turn a search into a list, causes first.

    slips: what names the slips of the pen of a control point.
    """
    causes = cause_findings(search.causes, slips)
    listed = camera_findings.of_sigma(search)
    listed += camera_findings.of_bias(search)
    listed += camera_findings.of_significance(search)
    listed += camera_findings.of_jackknife(search)
    listed += of_stated(search)
    listed += of_groups(search)
    listed += of_heads(search.last)
    listed += of_images(search)
    listed += of_maps(search)
    told = {(finding.code, finding.subject) for finding in causes}
    listed = [finding for finding in listed if (finding.code, finding.subject) not in told]
    return tuple(sorted((*causes, *listed), key=lambda finding: finding.small))
