"""The search of causes on a block: its network, its control as it was typed, and what it cannot separate."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork, fit
from photocal.adjustment.ledger import because
from photocal.base.arrays import Floats
from photocal.base.errors import PhotocalError
from photocal.block.model import Block
from photocal.block.network import NetworkOfBlock, assemble
from photocal.geometry.ground_scale import combined_factor
from photocal.georeferencing.local import as_mounted
from photocal.georeferencing.methods import without_georeference, without_weak_images
from photocal.georeferencing.separation import Separation, separation
from photocal.hypotheses.control import slips
from photocal.hypotheses.findings import Slips, no_slips
from photocal.hypotheses.search import SystematicErrors, straightened, systematic_errors
from photocal.hypotheses.table import FAULTS, Fault

Place = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Mistyped:
    """A control point whose coordinates do not fit the others.

    d, sigma (3,): computed from the other points minus given, and its standard deviation, m.
    slips: the likely slips, "code axis given wanted"; empty when none explains it.
    """

    point: str
    d: Floats
    sigma: Floats
    slips: tuple[str, ...]


def causes_of(
    block: Block, first: AdjustedNetwork | None = None, table: tuple[Fault, ...] = FAULTS
) -> tuple[SystematicErrors | None, Separation | None]:
    """Look for what is wrong with a block, and for what it cannot separate; None where it gives no hold.

    first: minimum of the very same observations, where it is known.
    """
    plain = without_weak_images(block)[0]
    mounted = as_mounted(plain)
    # What images state as positions is another network than the one that was adjusted.
    first = first if mounted is plain else None
    if block.datum == "free":
        return None, None
    if not len(mounted.positions.image):
        mounted = without_georeference(mounted)
    if first is None:
        network = assemble(mounted).network
        try:
            with because("the block to be tested for causes"):
                first = fit(network)
        except PhotocalError:
            # Wrong control may be what hinders: the rest of the block tells.
            return straightened(network), None
    try:
        found = systematic_errors(first, table=table)
    except PhotocalError:
        return None, None
    apart = separation(mounted, found.shared)
    if apart is not None and not len(block.positions.image):
        # Positions that images state have no lever arm that could be told from anything.
        groups = tuple(g for g in apart.groups if not all("lever_arm" in name for name in g))
        apart = replace(apart, groups=groups)
    return found, apart


def typed_slips(typed: Block, names: Sequence[str], places: Floats, to_given: Place) -> Slips:
    """What names the slips of the pen of a control point, from the coordinates that were typed.

    names, places (n, 3): of the points where they were adjusted, and how these become coordinates as typed.
    """
    row = {name: k for k, name in enumerate(typed.points.names)}
    local = {name: k for k, name in enumerate(names)}

    def of_point(point: str, error: Floats, sigma: Floats) -> tuple[str, ...]:
        """Slips of one point."""
        wanted = to_given((places[local[point]] + error)[None, :])[0]
        return slips(typed.points.values[row[point]], wanted, sigma, typed.frame)

    return Slips(of_point, _combined_factor(typed))


def _combined_factor(typed: Block) -> float:
    """Metres on the map of a block's frame that make one on the ground, in its middle; NaN for no map."""
    places = typed.points.values[typed.points.of_role("control")]
    places = places[np.isfinite(places).all(axis=1)]
    if typed.frame == "local" or not len(places):
        return math.nan
    try:
        return float(combined_factor(typed.frame, places.mean(axis=0)[None])[0])
    except PhotocalError:
        # Degrees and geocentric coordinates have no scale.
        return math.nan


def slips_of(block: Block, assembly: NetworkOfBlock) -> Slips:
    """The same for the network of a block."""
    network = assembly.network
    return typed_slips(block, network.point_names, network.points.values, assembly.frame.to_given)


def mistyped_of(found: SystematicErrors | None, named: Slips = no_slips) -> tuple[Mistyped, ...]:
    """Control points that contradict the others, with the slips that explain them."""
    listed = list[Mistyped]()
    for error in found.errors if found is not None and found.adequate else ():
        if error.cause is None or error.cause.fault.each != "point":
            continue
        for k, point in enumerate(error.cause.subject.split(" ")):
            own = error.hypothesis.estimates[3 * k : 3 * k + 3]
            d, sigma = -np.array([e.correction for e in own]), np.array([e.sigma for e in own])
            listed.append(Mistyped(point, d, sigma, named.of_point(point, d, sigma)))
    return tuple(listed)
