"""What of the table may be wrong with one network: each cause with its unknowns in the system of all."""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.condensed import Observed, observed
from photocal.adjustment.covariance import Shared
from photocal.adjustment.factored import factored
from photocal.adjustment.groups import Member, member_tests
from photocal.adjustment.mounting import COMMON, SHIFT, STRIPS, Mounting
from photocal.adjustment.network import Network
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import IllPosedError
from photocal.base.policy import policy
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.hypotheses.bent_rays import bent_rays
from photocal.hypotheses.control import Contradiction, control_points
from photocal.hypotheses.faults import FAULTS
from photocal.hypotheses.fields import LEFT, RayField, ray_fields
from photocal.hypotheses.system import Added, Beyond, System, loosened, system
from photocal.hypotheses.table import Fault

# So many positions and control points, the most contradicted ones, are tested in addition to all else.
_MOST_POSITIONS, _MOST_CONTROL = 8, 24
# What nature bounds is looked for where its largest amount would be found in 80 % of cases (Baarda 1968).
_FOUND = float(special.ndtri(1.0 - policy.significance / 2.0) + special.ndtri(policy.power)) ** 2
# Powers of the radius, for weak observations of coefficients.
_POWERS = {"K1": 2, "K2": 4, "K3": 6, "K4": 8, "P1": 1, "P2": 1, "P3": 3, "P4": 5, "B1": 0, "B2": 0}


def coarsely_placed(sigma: Floats, *, otherwise: bool) -> bool:
    """Whether nothing but navigation fixes, as pictures state them, places a block.

    sigma (n, 3): of the positions of the pictures, m; infinite where none is stated.
    otherwise: whether control or observed positions place it.
    """
    stated = sigma[np.isfinite(sigma).all(axis=1) & (sigma > 0.0).all(axis=1)]
    return bool(not otherwise and len(stated) and np.median(stated[:, :2]) > policy.coarse_m)


def of_rays(table: tuple[Fault, ...] = FAULTS) -> tuple[Fault, ...]:
    """Give what rays alone tell: errors of navigation fixes look like all else, a drift of c among it."""
    return tuple(entry for entry in table if entry.each == "field" and entry.code != "c-drift")


@dataclass(frozen=True, eq=False)
class Cause:
    """One hypothesis about a network.

    subject: camera, image, point, strip or parameter that is concerned.
    added: its unknowns behind the shared ones, see `System`.
    fixed: their amounts, where these are known: two points that changed places have no unknown.
    choices: how many such causes there are to choose from.
    members: positions (images), control points or the strip that are concerned.
    unknowns: how many there are.
    trend (positions, 3): what a unit of it changes of the antenna positions, m.
    """

    fault: Fault
    subject: str = ""
    added: tuple[int, ...] = ()
    fixed: tuple[float, ...] | None = None
    choices: int = 1
    members: tuple[int, ...] = ()
    unknowns: int = 1
    field: RayField | None = None
    trend: Floats | None = None

    @property
    def key(self) -> tuple[str, str]:
        """Code and subject: the same in every round."""
        return self.fault.code, self.subject


@dataclass(frozen=True)
class Candidates:
    """All causes that may be, in one system, at the minimum of a network.

    given: what the values of what images share bring, as the network states them.
    beside: places of what has been accepted before and is estimated with all else.
    """

    adjusted: AdjustedNetwork
    whole: System
    given: Observed
    causes: tuple[Cause, ...]
    fields: tuple[RayField, ...]
    beside: tuple[int, ...]
    members: tuple[Member, ...]

    @property
    def network(self) -> Network:
        """What was adjusted."""
        return self.adjusted.network

    def stated(self, causes: Sequence[Cause]) -> Observed:
        """What values of what images share bring with what some causes free: most free nothing of it."""
        opens = any(cause.fault.frees for cause in causes)
        return observed(self.whole.shared, *freed(self.network, causes)) if opens else self.given

    def beyond(self, causes: Sequence[Cause]) -> Beyond:
        """Give the equations of what may be added beside some causes, which are free.

        raises IllPosedError: when they cannot be separated from what is free already.
        """
        added = [k for cause in causes if cause.fixed is None for k in cause.added]
        beside = self.whole.beyond(self.stated(causes), (*self.beside, *added))
        for cause in causes:
            if cause.fixed is not None:
                beside = beside.moved(cause.added, cause.fixed)
        return beside

    def fall(self, before: Beyond, others: Sequence[Cause], cause: Cause) -> tuple[float, int]:
        """Give v'Pv and degrees of freedom with a cause free beside others.

        before: equations beside the others alone.
        raises IllPosedError: as `beyond`.
        """
        if cause.fixed is not None:
            after = before.moved(cause.added, cause.fixed)
        elif cause.fault.frees:
            after = self.beyond((*others, cause))
        else:
            return before.freed(cause.added)
        return after.chi_squared, after.degrees_of_freedom

    def solved(self, causes: Sequence[Cause]) -> tuple[Shared, dict[tuple[str, str], tuple[Floats, Floats]]]:
        """Give what is shared with some causes free, and the amounts of what was added, with covariances."""
        here = self.stated(causes)
        free = [cause for cause in causes if cause.fixed is None and cause.added]
        added = [k for cause in free for k in cause.added]
        shared, amounts, spread = self.whole.solved(here, (*added, *self.beside))
        told, at = {}, 0
        for cause in free:
            part = slice(at, at + len(cause.added))
            told[cause.key] = amounts[part], spread[part, part]
            at += len(cause.added)
        return shared, told

    def left(self) -> dict[tuple[str, str], float]:
        """What is left of the amounts of fields that were corrected, where it is more than a trace."""
        if not self.beside:
            return {}
        here = self.stated(())
        _, amounts, spread = self.whole.solved(here, self.beside)
        keys = [(self.fields[k].code, subject_of(self.network, self.fields[k])) for k in self.beside]
        sigma = np.sqrt(np.diag(spread))
        # Less of its sigma is no more than a trace of an amount.
        trace = 0.05
        return {
            key: float(amount)
            for key, amount, one in zip(keys, amounts, sigma, strict=True)
            if abs(amount) > trace * one
        }

    def of_control(self, causes: Sequence[Cause] = ()) -> tuple[float, int]:
        """What v'Pv falls by where each control point has an error of its own, and by how many of them.

        What all points have in common is no contradiction among them, nor is what other causes explain.
        """
        points = [cause for cause in self.causes if cause.fault.each == "point" and len(cause.members) == 1]
        added = [k for cause in points for k in cause.added]
        if not added:
            return 0.0, 0
        beside = self.beyond(causes)
        scale = np.sqrt(self.whole.lengths[added])
        left, axes = np.linalg.eigh(beside.matrix[np.ix_(added, added)] / np.outer(scale, scale))
        kept = left > LEFT
        root = np.sqrt(left[kept])
        shifts = scale[:, None] * np.tile(np.eye(3), (len(points), 1))
        common = root[:, None] * (axes.T[kept] @ (shifts / np.linalg.norm(shifts, axis=0)))
        # Without positions a shift of all of them is free.
        common = common[:, np.linalg.norm(common, axis=0) ** 2 > LEFT]
        d = (axes.T[kept] @ (beside.right[added] / scale)) / root
        shift, _, rank, _ = np.linalg.lstsq(common, d, rcond=None)
        # Points that are not tested one by one contradict less.
        further = 3 * (len(control_points(self.network)) - len(points))
        return float(np.sum((d - common @ shift) ** 2)), int(kept.sum()) - int(rank) + further

    def determined(self, causes: Sequence[Cause]) -> tuple[Cause, ...]:
        """Choose the causes whose unknown is something beside all others, and may be large enough."""
        alike = defaultdict[tuple[object, ...], list[Cause]](list)
        for cause in causes:
            if cause.field is not None or cause.trend is not None:
                alike[(cause.fault.code, *cause.members) if cause.fault.frees else ()].append(cause)
        hidden = {cause.key for some in alike.values() for cause in self._hidden(some)}
        return tuple(cause for cause in causes if cause.key not in hidden)

    def _hidden(self, causes: Sequence[Cause]) -> Iterator[Cause]:
        """Those of some causes of one unknown each, which free the same of what is shared, that are not."""
        try:
            left = np.diag(self.whole.beyond(self.stated(causes[:1]), self.beside).matrix)
        except IllPosedError:
            yield from causes
            return
        for cause in causes:
            (k,) = cause.added
            most = np.inf if cause.field is None else cause.field.most
            if not (
                left[k] > LEFT * self.whole.lengths[k] and (np.isinf(most) or left[k] * most**2 >= _FOUND)
            ):
                yield cause


def candidates(
    adjusted: AdjustedNetwork,
    table: tuple[Fault, ...] = FAULTS,
    contradiction: Contradiction | None = None,
    beside: tuple[tuple[str, str], ...] = (),
    near: str = "",
) -> Candidates:
    """Set up everything of a table that the observations of a network may tell.

    contradiction: control points that contradict the others.
    beside: keys of fields that were accepted before, and are estimated again.
    near: an image about which the place of a change of the camera is looked for more finely.
    raises IllPosedError: when the network does not bear the system.
    """
    network = adjusted.network
    wanted = {entry.each: entry for entry in table}
    free_cameras, free_mounting = freed(
        network, (Cause(entry) for entry in (*FAULTS, *table) if entry.frees and testable(network, entry))
    )
    opened = replace(network, cameras=free_cameras, mounting=free_mounting)
    fields = ray_fields(adjusted, near) + bent_rays(adjusted)
    fields = tuple(one for one in fields if any(entry.code == one.code for entry in table))
    members = member_tests(adjusted.factored, adjusted.solution) if {"image", "point"} & set(wanted) else ()
    placed = _worst(members, "position", _MOST_POSITIONS) if "image" in wanted else []
    control = _worst(members, "control", _MOST_CONTROL) if "point" in wanted else []
    known = set(control_points(network).tolist())
    control = [point for point in control if point in known and not network.points.held[point].any()]
    if contradiction is not None:
        control += [point for point in contradiction.points if point not in control]
    rows = np.array([(point, axis) for point in control for axis in range(3)], dtype=np.int64).reshape(-1, 2)
    # What is added takes from the measurement what it gives to the computed coordinates.
    rays = np.empty((len(fields), *network.rays.plane.shape))
    for row, one in zip(rays, fields, strict=True):
        np.negative(one.displacement, out=row)
    trends = _trends(network, table)
    of_positions = [_of_positions(network, placed), *(_whitened(network, one) for one in trends.values())]
    added = Added(rays, np.vstack(of_positions), rows)
    at = factored(opened, adjusted.state)
    whole = system(at, adjusted.solution.residuals, added)
    listed = [_whole(network, entry) for entry in table if _of_block(network, entry)]
    listed += _of_strips(network, wanted.get("one-strip"))
    listed += _of_fields(network, table, fields)
    first = len(fields)
    if "image" in wanted:
        listed += [
            Cause(
                wanted["image"],
                network.image_names[image],
                tuple(range(first + 3 * k, first + 3 * k + 3)),
                choices=len(network.positions.image),
                members=(image,),
                unknowns=3,
            )
            for k, image in enumerate(placed)
        ]
    first += 3 * len(placed)
    listed += [
        Cause(entry, added=(first + k,), unknowns=1 + len(entry.frees), trend=trend)
        for k, (entry, trend) in enumerate(trends.items())
    ]
    first += len(trends)
    place = {point: tuple(range(first + 3 * k, first + 3 * k + 3)) for k, point in enumerate(control)}
    listed += _of_control(network, table, place, contradiction)
    again = tuple(k for k, one in enumerate(fields) if (one.code, subject_of(network, one)) in beside)
    given = observed(whole.shared, network.cameras, network.mounting)
    made = Candidates(adjusted, whole, given, (), fields, again, members)
    taken = set(beside)
    return replace(made, causes=made.determined([cause for cause in listed if cause.key not in taken]))


def subject_of(network: Network, field: RayField) -> str:
    """What a field is about: its camera, and the term or image where there is one."""
    return f"{network.cameras[field.camera].id} {field.parameter}".strip()


def _worst(members: Sequence[Member], kind: str, most: int) -> list[int]:
    """The most contradicted positions or control points."""
    own = [member for member in members if member.kind == kind and member.dimensions == 3]
    return [member.index for member in sorted(own, key=lambda member: -member.statistic)[:most]]


def _of_positions(network: Network, images: Sequence[int]) -> Floats:
    """Errors of the positions of some images, three axes each, whitened: (3 images, 3 positions)."""
    positions = network.positions
    fields = np.zeros((3 * len(images), 3 * len(positions.image)))
    row = {int(image): k for k, image in enumerate(positions.image)}
    for k, image in enumerate(images):
        at = row[image]
        whitening = np.linalg.inv(np.linalg.cholesky(positions.covariance[at]))
        fields[3 * k : 3 * k + 3, 3 * at : 3 * at + 3] = whitening.T
    return fields


def _trends(network: Network, table: Sequence[Fault]) -> dict[Fault, Floats]:
    """Trends of all positions against control, by what a unit of each changes, (positions, 3) m."""
    entries = {entry.code: entry for entry in table if entry.each == "trend"}
    # A scale needs two places.
    least_scaled = 2
    if len(network.positions.image) < policy.smallest_sample or len(control_points(network)) < least_scaled:
        return {}
    away = network.positions.values - network.positions.values.mean(axis=0)
    known = {"positions-scale": away * [1.0, 1.0, 0.0]}
    return {entry: known[code] for code, entry in entries.items() if code in known}


def _whitened(network: Network, trend: Floats) -> Floats:
    """A trend of the positions in their standard deviations, (3 positions,)."""
    roots = np.linalg.cholesky(network.positions.covariance)
    return np.asarray(np.linalg.solve(roots, trend[:, :, None]).ravel())


def _of_block(network: Network, entry: Fault) -> bool:
    return (
        bool(entry.frees)
        and entry.each in ("block", "strip")
        and testable(network, entry)
        and not left_free(network, entry)
    )


def _whole(network: Network, entry: Fault) -> Cause:
    """A cause of the whole block, or of every camera or strip."""
    cause = Cause(entry)
    times = len(network.cameras) if of_camera(entry) else 1
    count = len(entry.frees) * times if of_camera(entry) else len(common_columns(network, cause))
    return replace(cause, unknowns=count)


def _of_strips(network: Network, entry: Fault | None) -> list[Cause]:
    strips, count = np.unique(network.positions.strip, return_counts=True)
    if entry is None or len(strips) < 2 or np.any(network.mounting.sigma[STRIPS:]):
        return []
    listed = []
    # Strips with fewer positions are not tested one by one.
    least_of_strip = 3
    for strip in strips[count >= least_of_strip].tolist():
        names = [network.image_names[i] for i in network.positions.image[network.positions.strip == strip]]
        subject = f"{names[0]}-{names[-1]}"
        listed.append(Cause(entry, subject, choices=len(strips), members=(strip,), unknowns=len(entry.frees)))
    return listed


def _of_fields(network: Network, table: tuple[Fault, ...], fields: tuple[RayField, ...]) -> list[Cause]:
    places = sum(field.code == "camera-change" for field in fields)
    listed = []
    for k, field in enumerate(fields):
        entry = next(entry for entry in table if entry.code == field.code)
        held = 0
        if entry.each == "part":
            camera = network.cameras[field.camera]
            at = [PARAMETERS.index(name) for name in entry.frees]
            held = sum(not camera.estimated[p] or bool(np.isfinite(camera.prior_sigma[p])) for p in at)
        listed.append(
            Cause(
                entry,
                subject_of(network, field),
                (k,),
                choices=places if entry.each == "part" else 1,
                members=(field.camera,),
                unknowns=1 + held,
                field=field,
            )
        )
    return listed


def _of_control(
    network: Network,
    table: tuple[Fault, ...],
    place: dict[int, tuple[int, ...]],
    contradiction: Contradiction | None,
) -> list[Cause]:
    """Control points one by one, and those that contradict the others together."""
    of = {entry.each: entry for entry in table}
    if "point" not in of:
        return []
    count = len(control_points(network))
    enough = count >= policy.fewest_control_to_blame
    listed = [
        Cause(of["point"], network.point_names[j], columns, choices=count, members=(j,), unknowns=3)
        for j, columns in place.items()
        if enough
    ]
    if contradiction is None or (len(contradiction.points) == 1 and not contradiction.exchanged):
        return listed
    names = " ".join(network.point_names[j] for j in contradiction.points)
    columns = tuple(k for j in contradiction.points for k in place[j])
    if contradiction.exchanged and "pair" in of:
        # The error of what was given: the other's coordinates less the own ones.
        amounts = tuple((-contradiction.error).ravel().tolist())
        pair = Cause(of["pair"], names, columns, amounts, contradiction.choices, contradiction.points, 0)
        return [*listed, pair]
    several = Cause(
        of["point"], names, columns, choices=contradiction.choices, members=contradiction.points,
        unknowns=len(columns),
    )  # fmt: skip
    return [*listed, several]


def points_of(network: Network, cause: Cause) -> tuple[str, ...]:
    """Names of the control points that a cause concerns; a name may have blanks."""
    return tuple(network.point_names[j] for j in cause.members)


def of_camera(entry: Fault) -> bool:
    """Whether a fault frees parameters of cameras; the others free values of the mounting."""
    return bool(entry.frees) and entry.frees[0] in PARAMETERS


def left_free(network: Network, entry: Fault) -> bool:
    """Tell whether the network leaves values of a fault free: all of the mounting, any of a camera."""
    if of_camera(entry):
        at = [PARAMETERS.index(name) for name in entry.frees]
        return any(
            bool(camera.estimated[k]) and not math.isfinite(camera.prior_sigma[k])
            for camera in network.cameras
            for k in at
        )
    sigma = network.mounting.sigma
    at = first_strip(entry) if entry.each in ("strip", "one-strip") else columns_of(entry)
    return len(sigma) > max(at) and bool(np.isinf(sigma[at]).all())


def testable(network: Network, entry: Fault) -> bool:
    """Whether the observations of a network can say anything of what a fault frees."""
    if of_camera(entry):
        return True
    if not len(network.positions.image):
        return False
    if entry.each in ("strip", "one-strip"):
        return len(np.unique(network.positions.strip)) > 1
    if entry.frees[0].startswith("boresight"):
        return len(network.attitudes.image) > 0
    return entry.frees[0] != "time_offset" or bool(np.any(network.positions.velocity))


def freed(network: Network, causes: Iterable[Cause]) -> tuple[tuple[Camera, ...], Mounting]:
    """Cameras and mounting with what some causes free, weakly observed as it is given."""
    opening = [cause for cause in causes if cause.fault.frees]
    if not opening:
        return network.cameras, network.mounting
    cameras, sigma = list(network.cameras), network.mounting.sigma.copy()
    for cause in opening:
        entry = cause.fault
        if of_camera(entry):
            at = cause.members[:1] if entry.each == "part" and cause.members else range(len(cameras))
            for k in at:
                c = cameras[k].value("c")
                priors = {
                    PARAMETERS.index(name): entry.prior
                    * (c if PARAMETERS.index(name) < 3 else (2.0 / c) ** _POWERS[name])
                    for name in entry.frees
                }
                cameras[k] = loosened(
                    cameras[k],
                    {
                        p: v
                        for p, v in priors.items()
                        if not (cameras[k].estimated[p] and not np.isfinite(cameras[k].prior_sigma[p]))
                    },
                )
            continue
        for column in common_columns(network, cause):
            # What is free already stays so.
            sigma[column] = sigma[column] if np.isinf(sigma[column]) else entry.prior
    return tuple(cameras), replace(network.mounting, sigma=sigma)


def common_columns(network: Network, cause: Cause) -> list[int]:
    """Common values that a cause frees; images without position have no strip, their columns stay held."""
    entry = cause.fault
    if entry.each not in ("strip", "one-strip"):
        return columns_of(entry)
    strips: Integers | tuple[int, ...] = np.unique(network.positions.strip)
    if entry.each == "one-strip" and cause.members:
        strips = cause.members
    return [6 * int(strip) + k for strip in strips for k in first_strip(entry)]


def columns_of(entry: Fault) -> list[int]:
    """Common values that a fault frees once."""
    return [COMMON.index(name) for name in entry.frees]


def first_strip(entry: Fault) -> list[int]:
    """Columns of the first strip's own values; those of the next one follow by six."""
    return [STRIPS + k - SHIFT.start for k in columns_of(entry)]
