"""A camera that moved on its frame: found by what its relations to the other heads resist."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from drivers.arrays import Floats, Integers
from photocal.adjustment.envelope import solve
from photocal.adjustment.observations import mounting_equations
from photocal.analysis.systematic_errors.refit import Fit
from photocal.findings.finding import Finding, Size

# The whole family alarms on a clean block in no more than 5 of 1000 cases; places in the flight at which a
# head is tried to have moved, and exposures that must lie before and after.
LEVEL = 0.005
PLACES, FEWEST = 16, 3


@dataclass(frozen=True)
class HeadMove:
    """A jump of a head on its frame.

    move, sigma (6,): turns about its axes (rad) and shifts in those of the first head (m).
    before: images of the head before which it moved, the first of the later ones.
    p_value: of no jump, for all heads and places that were tried.
    """

    camera: str
    before: str
    move: Floats
    sigma: Floats
    p_value: float


def head_move(fitted: Fit) -> HeadMove | None:
    """Test whether a head moved between exposures: the likeliest head and place; None without relations."""
    network, state, at = fitted.network, fitted.state, fitted.factored
    rig = network.rig
    if not len(rig.first):
        return None
    layout = at.problem.layout
    equations = mounting_equations(network, layout, state)["rig"]
    head, when = rig.head_of(network.exposures.camera), network.exposures.time
    # Exposures without a time stand in the order of their images.
    known = when is not None and np.isfinite(when).all()
    moment = when[rig.second] if known and when is not None else rig.second.astype(float)
    tried = []
    for k in np.unique(head[rig.second]).tolist():
        pairs = np.flatnonzero(head[rig.second] == k)
        pairs = pairs[np.argsort(moment[pairs], kind="stable")]
        if len(pairs) < 2 * FEWEST:
            continue
        starts = np.unique(np.linspace(FEWEST, len(pairs) - FEWEST, PLACES).astype(np.int64))
        for start in starts.tolist():
            later = pairs[start:]
            rows, slope = _rows(later, len(rig.first)), 1.0 / rig.stiffness[k, ::-1].repeat(3)
            design = np.zeros((layout.size, 6))
            force = np.zeros(6)
            for n in range(6):
                for row in rows[n].tolist():
                    span = slice(equations.start[row], equations.start[row + 1])
                    np.add.at(design[:, n], equations.column[span], slope[n] * equations.coefficient[span])
                force[n] = slope[n] * equations.residual[rows[n]].sum()
            inside = solve(layout.envelope, at.normal.matrix, design)
            normal = np.diag(len(later) * slope**2) - design.T @ inside
            # The jump in units in which the stiffness is 1: what nothing resists has no share.
            scaled = normal / np.outer(slope, slope)
            value, vector = np.linalg.eigh((scaled + scaled.T) / 2)
            good = value > 1e-9 * len(later)
            inverse = (vector[:, good] / value[good]) @ vector[:, good].T / np.outer(slope, slope)
            move = inverse @ force
            tried.append((float(force @ move), int(good.sum()), k, int(later[0]), move, inverse))
    if not tried:
        return None
    # One that moves pulls at the others: the one that moved most is named.
    chi_squared, freedom, k, pair, move, inverse = max(tried, key=lambda one: one[0] / one[1])
    p_value = min(1.0, len(tried) * float(special.chdtrc(freedom, chi_squared)))
    camera, name = network.cameras[rig.camera[k]].id, network.image_names[rig.second[pair]]
    return HeadMove(camera, name, move, np.sqrt(np.diag(inverse)), p_value)


def _rows(pairs: Integers, count: int) -> Integers:
    """Rows of the relations of some pairs, by component: three turns, then three shifts, shape (6, pairs)."""
    return np.array([(n // 3) * 3 * count + 3 * pairs + n % 3 for n in range(6)])


def of_heads(fitted: Fit) -> list[Finding]:
    """Name the head that moved."""
    one = head_move(fitted)
    if one is None or one.p_value >= LEVEL:
        return []
    turn, shift = float(np.linalg.norm(one.move[:3])), float(np.linalg.norm(one.move[3:]))
    figures = {
        "camera": one.camera,
        "image": one.before,
        "turn_arcsec": 3600.0 * float(np.degrees(turn)),
        "shift_mm": 1000.0 * shift,
        "p": one.p_value,
    }
    size = Size(float(np.degrees(turn)), "deg", float(np.degrees(np.linalg.norm(one.sigma[:3]))))
    return [Finding("head-moved", "grave", one.camera, figures, size=size)]
