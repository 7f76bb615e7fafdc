"""The network: what is adjusted and what was observed, as arrays."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from photocal.adjustment.lasers import NO_LASERS, LaserDistances
from photocal.adjustment.mounting import (
    NO_ATTITUDES,
    NO_MOUNTING,
    NO_POSITIONS,
    Attitudes,
    Mounting,
    Positions,
)
from photocal.adjustment.rig import NO_RIG, RigHeads
from photocal.base.arrays import Columns, Flags, Floats, Integers
from photocal.geometry.camera import MOTION, OWN, PARAMETERS, SHAKE_DEGREES, Camera

# Kinds of observations between points, and which points a row of each names, in the order of its columns.
RELATIONS = {
    "distance": ("from", "to"),
    "height_difference": ("from", "to"),
    "azimuth": ("from", "to"),
    "vertical_angle": ("from", "to"),
    "horizontal_angle": ("at", "from", "to"),
    "line": ("from", "to", "point"),
}
ANGLES = ("azimuth", "vertical_angle", "horizontal_angle")
# From differences of points, shape (n, 3): the values, and their derivatives with respect to the second.
Related = Callable[[Floats], tuple[Floats, Floats]]


@dataclass(frozen=True)
class ExteriorOrientations(Columns):
    """Exterior orientation of the images: start values, and observations where a sigma stands.

    camera (n,): index of the camera of each image.
    values (n, 6): omega, phi, kappa in radians, X, Y, Z of the projection centre in m.
    sigma (n, 6): 0 holds the value, a positive sigma makes it an observation, infinity leaves it free.
    motion (n, 6 or 21), motion_sigma (n, 6): for a rolling shutter: velocity in m/s in the object frame,
        rate in rad/s about the axes of the camera (the turn that takes old axes to new ones), by how much the
        image departs from them; None at rest. Their product with the readout moves it; a departure is an
        unknown of the image whose sigma is that of the motion times the camera's given readout.
    time, temperature (n,): of the exposures, s and degrees Celsius, NaN where not known; for the analysis.
    start (n, 6): start values, where they are other than what was observed.
    """

    camera: Integers
    values: Floats
    sigma: Floats
    motion: Floats | None = None
    motion_sigma: Floats | None = None
    time: Floats | None = None
    temperature: Floats | None = None
    start: Floats | None = None

    @property
    def started(self) -> Floats:
        """Start values, (n, 6)."""
        return self.values if self.start is None else self.start


@dataclass(frozen=True)
class Points(Columns):
    """Object points: start values, and observations where a covariance stands.

    values (n, 3): X, Y, Z in m: start values and, where weighted, observed values.
    held (n, 3): coordinates that keep their value.
    weight (n, 3, 3): inverse of the covariance of the observed coordinates; zero rows and columns where free.
    """

    values: Floats
    held: Flags
    weight: Floats

    @cached_property
    def observed(self) -> Flags:
        """Which coordinates are observed, (n, 3): of each point as many as its weights have a rank.

        The vertical of a point is that of the object system nearly, not wholly: where its height is free, the
        plane coordinates alone give the third axis a weight, too.
        """
        weight = np.diagonal(self.weight, axis1=1, axis2=2)
        observed = np.asarray(weight > 0)
        known = np.flatnonzero(observed.any(axis=1))
        # Sigmas of one point differ by less; what is not observed is zero but for rounding.
        least = 1e-13
        strengths = np.linalg.eigvalsh(self.weight[known])
        rank = np.sum(strengths > least * strengths[:, -1:], axis=1)
        strongest = np.argsort(np.argsort(-weight[known], axis=1, kind="stable"), axis=1)
        observed[known] &= strongest < rank[:, None]
        return observed

    @cached_property
    def known(self) -> Integers:
        """Points of which something is observed."""
        return np.flatnonzero(self.observed.any(axis=1))


@dataclass(frozen=True)
class Rays(Columns):
    """Image observations, sorted by point.

    image, point (n,): what was seen where.
    plane (n, 2): measured coordinates in the image plane (x right, y up), in the unit of the camera.
    sigma (n, 2): standard deviations in the same unit.
    """

    image: Integers
    point: Integers
    plane: Floats
    sigma: Floats


@dataclass(frozen=True)
class Relations(Columns):
    """Observations between two or three object points.

    kind (n,): index into `RELATIONS`: slope distance in m, Z of `second` less Z of `first` in m, azimuth from
        the Y axis towards X in radians, angle of the line from `first` to `second` above the X, Y plane,
        angle at `first` from `second` to `third` in the sense of azimuths, and the distance (0) of `third`
        from the straight line through the others, which counts as two observations.
    first, second (n,): points.
    values, sigma (n,).
    third (n,): a third point, -1 where a kind has none; None where no kind has.
    further: kinds beyond these, numbered behind `RELATIONS`: name and function of each.
    """

    kind: Integers
    first: Integers
    second: Integers
    values: Floats
    sigma: Floats
    third: Integers | None = None
    further: tuple[tuple[str, Related], ...] = field(default=(), kw_only=True)

    @property
    def ends(self) -> Integers:
        """Points of each row, shape (n, 3); -1 where there is no third."""
        third = np.full(len(self.kind), -1) if self.third is None else self.third
        return np.column_stack([self.first, self.second, third]).astype(np.int64)

    @property
    def points(self) -> Integers:
        """All points that are named, sorted."""
        named = np.unique(self.ends)
        return np.asarray(named[named >= 0])

    def plus(self, *others: "Relations") -> "Relations":
        """Add rows behind these."""
        parts = [part for part in (self, *others) if len(part.kind)] or [self]
        first, second, third = np.concatenate([part.ends for part in parts]).T
        kind, values, sigma = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("kind", "values", "sigma")
        )
        return Relations(kind, first, second, values, sigma, third, further=self.further)

    def moved(self, place: Integers) -> "Relations":
        """Name points by their new places."""
        first, second, third = np.append(place, -1)[self.ends].T
        return replace(self, first=first, second=second, third=None if self.third is None else third)

    @property
    def names(self) -> tuple[str, ...]:
        """Kinds by their number."""
        return (*RELATIONS, *(name for name, _ in self.further))


_NONE = np.zeros(0, dtype=np.int64)
NO_RELATIONS = Relations(_NONE, _NONE, _NONE, np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class Network:
    """Everything that enters one adjustment.

    image_names, point_names: what to call images and points in messages.
    relations: observations between points.
    datum_points: points over which a free network is least moved (inner constraints); None when the
        observations carry the datum.
    positions, attitudes, mounting: observations of a GNSS antenna and an inertial unit, and how they are
        mounted.
    rig: cameras that are fixed to each other.
    lasers: distances from images to the surface of the points.
    """

    cameras: tuple[Camera, ...]
    exposures: ExteriorOrientations
    points: Points
    rays: Rays
    image_names: tuple[str, ...]
    point_names: tuple[str, ...]
    relations: Relations = NO_RELATIONS
    datum_points: Integers | None = None
    positions: Positions = NO_POSITIONS
    attitudes: Attitudes = NO_ATTITUDES
    mounting: Mounting = NO_MOUNTING
    rig: RigHeads = NO_RIG
    lasers: LaserDistances = NO_LASERS

    @cached_property
    def lens_by_image(self) -> bool:
        """Whether images of one camera differ by more than their exterior orientation."""
        varied = any((camera.deviation_sigma > 0).any() for camera in self.cameras)
        return varied or any(camera.rolling for camera in self.cameras)

    @cached_property
    def observed_cameras(self) -> Integers:
        """Cameras of which a parameter that is estimated was observed, too."""
        observed = [bool(np.isfinite(c.prior_sigma[c.estimated]).any()) for c in self.cameras]
        return np.flatnonzero(observed)


def own_sigma(network: Network) -> Floats:
    """Sigmas of each image's own parameters, shape (images, 41); 0 for those it has from its camera."""
    exposures = network.exposures
    cameras = np.array([camera.deviation_sigma for camera in network.cameras]).reshape(-1, len(PARAMETERS))
    sigma = np.zeros((len(exposures.camera), len(OWN)))
    sigma[:, : len(PARAMETERS)] = cameras[exposures.camera]
    if exposures.motion_sigma is not None:
        readout = np.array([abs(camera.value("readout")) for camera in network.cameras])[exposures.camera]
        rolls = readout > 0
        still, moved = len(PARAMETERS), len(PARAMETERS + MOTION)
        sigma[rolls, still:moved] = exposures.motion_sigma[rolls] * readout[rolls, None]
        degrees = 1 + len(SHAKE_DEGREES)
        shake = np.array([[*camera.shake, *[0.0] * degrees][:degrees] for camera in network.cameras])
        shake = np.where(rolls[:, None], shake[exposures.camera], 0.0)
        sigma[:, moved - 3 : moved] = np.hypot(sigma[:, moved - 3 : moved], shake[:, :1])
        sigma[:, moved:] = np.repeat(shake[:, 1:], 3, axis=1)
    return sigma


def own_parameters(network: Network) -> Integers:
    """Positions of each image's own parameters in `OWN`, shape (images, most); -1 where it has fewer."""
    varied = own_sigma(network) > 0
    count = varied.sum(axis=1)
    most = int(count.max(initial=0))
    first = np.argsort(~varied, axis=1, kind="stable")[:, :most]
    return np.where(np.arange(most) < count[:, None], first, -1)


def covariance_matrices(sigma: Floats, cross: Floats) -> Floats:
    """Covariance matrices, shape (n, 3, 3), from sigmas of X, Y, Z and covariances XY, XZ, YZ."""
    matrix = np.zeros((len(sigma), 3, 3))
    matrix[:, [0, 1, 2], [0, 1, 2]] = sigma**2
    for k, (a, b) in enumerate(((0, 1), (0, 2), (1, 2))):
        matrix[:, a, b] = matrix[:, b, a] = cross[:, k]
    return matrix


def point_weights(sigma: Floats) -> tuple[Flags, Floats]:
    """Held coordinates and weight matrices from the standard deviations of coordinates.

    sigma (n, 3): 0 holds a coordinate, a positive value weights it, infinity leaves it free.
    returns held (n, 3).
    returns weight (n, 3, 3).
    """
    held = sigma == 0
    weight = np.zeros((len(sigma), 3, 3))
    diagonal = np.where(held, 0.0, np.divide(1.0, sigma, where=~held, out=np.zeros_like(sigma)) ** 2)
    weight[:, [0, 1, 2], [0, 1, 2]] = diagonal
    return held, weight
