"""Severity from harm: grave is what harms more than was asked for, where its cause is known.

What is determined but harmless is a note, what is harmful but not determined is a reservation.
"""

import math
from dataclasses import dataclass, replace

from photocal.base.policy import policy
from photocal.findings.finding import Finding

# Clauses that name rivals: causes that explain the observations as well.
_RIVALS = frozenset(("same", "as-good", "alike", "or-points"))
# Clauses in metres, and what is said instead where a block has no scale.
_METRES = {"shifts_c": "shifts_c_alone", "heights_hang": "heights_hang_alone", "at_this_distance": ""}


@dataclass(frozen=True)
class Asked:
    """What a block is asked for, and what turns an error of its parameters into one on the ground.

    ground_m: from which error on the ground on something is harmful, m.
    distance_m: from camera to ground, m.
    speed_m_s: of the vehicle over ground, m/s; 0 where it is not known.
    c: principal distance, in its unit.
    """

    ground_m: float
    distance_m: float
    speed_m_s: float = 0.0
    c: float = math.nan


def harmful_from(pixel_on_ground_m: float, target_m: float | None) -> float:
    """Give the error on the ground from which on something is harmful.

    target_m: root mean square error that was asked for; without one, a pixel is the measure.
    """
    return pixel_on_ground_m if target_m is None else policy.harm_share * target_m


def on_ground(finding: Finding, asked: Asked) -> float | None:
    """Give how far an error moves points: of this block, or of one that its values are carried to.

    returns: m; None where the finding does not say it.
    """
    size, figures = finding.size, finding.figures
    effects = [figures.get("moved_plane_m"), figures.get("moved_height_m")]
    if size is not None:
        per_unit = {"m": 1.0, "deg": math.radians(1.0) * asked.distance_m, "s": asked.speed_m_s}
        effects += [size.ground_m, abs(size.figure) * per_unit.get(size.unit, math.nan)]
    effects.append(figures.get("change_of_c", math.nan) / asked.c * asked.distance_m)
    known = [abs(effect) for effect in effects if isinstance(effect, float) and math.isfinite(effect)]
    return max(known) if known else None


def weighed(finding: Finding, asked: Asked) -> Finding:
    """Give a finding the severity of its harm; one whose harm is not known keeps its own.

    What moves image points visibly harms whatever is measured in them, however little it moves this block.
    """
    effect = on_ground(finding, asked)
    if effect is None or finding.severity not in ("grave", "doubtful"):
        return finding
    size = finding.size and replace(finding.size, ground_m=effect)
    seen = size is not None and (size.px or 0.0) >= policy.small_px
    if effect < asked.ground_m and not seen:
        return replace(finding, severity="note", size=size)
    if finding.severity == "grave" and _RIVALS & set(finding.clauses):
        return replace(finding, severity="doubtful", size=size)
    return replace(finding, size=size)


def without_metres(finding: Finding, asked: Asked) -> Finding:
    """Tell what an error does by its share of the distance: a block without scale has no metres."""
    size = finding.size
    if size is not None and size.ground_m is not None:
        size = replace(size, ground_m=None, of_distance=abs(size.ground_m) / asked.distance_m)
    clauses = tuple(filter(None, (_METRES.get(clause, clause) for clause in finding.clauses)))
    figures = {key: value for key, value in finding.figures.items() if key != "ground_m"}
    return replace(finding, size=size, clauses=clauses, figures=figures)
