"""A block: cameras, images, points and their observations, as the surveyor gave them."""

from dataclasses import dataclass, field, replace
from html import escape
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, Self

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
from photocal.adjustment.network import NO_RELATIONS, Relations
from photocal.base.arrays import Columns, Flags, Floats, Integers
from photocal.base.chi_square import Sided
from photocal.base.files import digest
from photocal.block.rig import Head
from photocal.geometry.camera import Camera
from photocal.geometry.oriented_images import OrientedImages

Role = Literal["control", "check", "tie"]
ROLES: tuple[Role, ...] = ("control", "check", "tie")
# Named, not imported: they stand on this module.
_READER, _WRITER = "photocal.block.folder", "photocal.block.writer"


@dataclass(frozen=True)
class InputFile:
    """A file that was read, so that it can be recognised again.

    path: relative to the block folder.
    """

    path: str
    sha256: str
    bytes: int


def fingerprint(path: Path, name: str = "") -> InputFile:
    """What a file is recognised by, under a name (its own where none is given)."""
    return InputFile(name or path.name, digest(path), path.stat().st_size)


@dataclass(frozen=True)
class Images:
    """Images with their exterior orientation in the block's frame.

    Attributes
    ----------
    camera : array, shape (n,)
        Index into the block's cameras.
    values, sigma : array, shape (n, 6)
        Omega, phi, kappa in radians, X, Y, Z in m; sigma 0 holds a value, infinity leaves it free. Where
        they are not given nothing is known: NaN and infinity.
    motion, motion_sigma : array, shape (n, 6)
        Velocity (m/s) and rate (rad/s) as `adjustment.network.Exposures` has them; NaN where not known.
        `motion` has 15 columns more where a gyroscope has recorded how images shake.
    time : array, shape (n,)
        Of the exposure, s; NaN where it is not known.
    temperature : array, shape (n,)
        Of the camera or the air at the exposure, degrees Celsius; NaN where it is not known.
    exposure
        Key that the images of several cameras on one frame share; empty for a single image.
    """

    names: tuple[str, ...]
    camera: Integers
    values: Floats = field(default_factory=lambda: np.zeros((0, 6)))
    sigma: Floats = field(default_factory=lambda: np.zeros((0, 6)))
    motion: Floats = field(default_factory=lambda: np.zeros((0, 6)))
    motion_sigma: Floats = field(default_factory=lambda: np.zeros((0, 6)))
    time: Floats = field(default_factory=lambda: np.zeros(0))
    temperature: Floats = field(default_factory=lambda: np.zeros(0))
    exposure: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Fill what is not known."""
        for name in ("values", "sigma", "motion", "motion_sigma", "time", "temperature"):
            if len(getattr(self, name)) != len(self.names):
                shape = (len(self.names), *getattr(self, name).shape[1:])
                object.__setattr__(self, name, np.full(shape, np.inf if name == "sigma" else np.nan))
        if len(self.exposure) != len(self.names):
            object.__setattr__(self, "exposure", ("",) * len(self.names))

    def some(self, rows: Integers) -> "Images":
        """Give those images only."""
        columns: dict[str, Any] = {
            name: tuple(column[k] for k in rows) if isinstance(column, tuple) else column[rows]
            for name, column in vars(self).items()
        }
        return Images(**columns)

    @staticmethod
    def observed(images: OrientedImages) -> "Images":
        """Take oriented images as observed with their sigmas; free where these are not known."""
        sigma = np.where(np.isfinite(images.sigma), images.sigma, np.inf)
        return Images(images.names, images.camera, images.values, sigma)


@dataclass(frozen=True)
class ObjectPoints:
    """Object points.

    Attributes
    ----------
    values : array, shape (n, 3)
        X, Y, Z in m; NaN where a tie point has no start value.
    sigma : array, shape (n, 3)
        Of the surveyed coordinates; 0 holds a coordinate, infinity leaves it free, as where it is not
        given.
    role : array, shape (n,)
        Index into `ROLES`; tie points where it is not given.
    cross : array, shape (n, 3)
        Covariances XY, XZ, YZ of the surveyed coordinates, m^2; zero when they are not given.
    """

    names: tuple[str, ...]
    values: Floats
    sigma: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    role: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    cross: Floats | None = None

    def __post_init__(self) -> None:
        """Make tie points of what nothing else is said of."""
        if not len(self.sigma):
            object.__setattr__(self, "sigma", np.full((len(self.names), 3), np.inf))
        if not len(self.role):
            object.__setattr__(self, "role", np.full(len(self.names), ROLES.index("tie")))

    def of_role(self, role: Role) -> Flags:
        """Which points play a role, shape (n,)."""
        return np.asarray(self.role == ROLES.index(role))

    def only(self, chosen: Flags | Integers) -> "ObjectPoints":
        """Give some of the points."""
        names = tuple(self.names[k] for k in np.arange(len(self.names))[chosen])
        cross = None if self.cross is None else self.cross[chosen]
        return ObjectPoints(names, self.values[chosen], self.sigma[chosen], self.role[chosen], cross)

    def with_ties(self, names: tuple[str, ...], values: Floats) -> "ObjectPoints":
        """Add tie points behind these; values (n, 3): m, NaN where they are not known."""
        return self.plus(ObjectPoints(names, values))

    def plus(self, more: "ObjectPoints") -> "ObjectPoints":
        """Add points of other names behind these."""
        crosses = [np.zeros((len(p.names), 3)) if p.cross is None else p.cross for p in (self, more)]
        return ObjectPoints(
            self.names + more.names,
            np.vstack([self.values, more.values]),
            np.vstack([self.sigma, more.sigma]),
            np.concatenate([self.role, more.role]),
            None if self.cross is None and more.cross is None else np.vstack(crosses),
        )


@dataclass(frozen=True)
class Observations(Columns):
    """Image observations, in the order of their table.

    Attributes
    ----------
    axes
        Column and row from the upper-left pixel, or ("photo") x right and y up from the middle of the
        image.
    image, point : array, shape (n,)
        Indices into those of the block.
    values, sigma : array, shape (n, 2)
        In `unit` and `axes`.
    """

    unit: Literal["px", "mm"]
    axes: Literal["pixel", "photo"]
    image: Integers
    point: Integers
    values: Floats
    sigma: Floats

    def plus(self, image: Integers, point: Integers, values: Floats, sigma: Floats) -> Self:
        """Add observations behind these."""
        return replace(
            self,
            image=np.concatenate([self.image, image]),
            point=np.concatenate([self.point, point]),
            values=np.vstack([self.values, values]),
            sigma=np.vstack([self.sigma, sigma]),
        )


NO_POINTS = ObjectPoints((), np.zeros((0, 3)))
_NONE = np.zeros(0, dtype=np.int64)
NO_OBSERVATIONS = Observations("px", "pixel", _NONE, _NONE, np.zeros((0, 2)), np.zeros((0, 2)))


@dataclass(frozen=True)
class FiducialFit:
    """How the fiducial marks of an image fit when readings are turned into image coordinates.

    residuals (n, 2): computed minus known, in the unit of the camera.
    sigma0: standard deviation of a coordinate of a mark; NaN without redundancy.
    """

    image: str
    fiducials: tuple[str, ...]
    residuals: Floats
    redundancy: int
    sigma0: float


@dataclass(frozen=True)
class Repetition:
    """How repeated readings of one point in one image agree.

    readings, rejected: all of them, and those farther from the mean of the others than the limit.
    limit: in the unit of the observations.
    least, most: readings that stay of a point in an image.
    sigma: standard deviations of a single reading in x and y, pooled; None where nothing is repeated.
    """

    readings: int
    rejected: int
    limit: float
    least: int
    most: int
    sigma: tuple[float, float] | None = None


@dataclass(frozen=True, repr=False)
class Block:
    """Everything in a block folder.

    Attributes
    ----------
    frame
        "local", or the name of a coordinate reference system.
    height
        Kind of the heights.
    datum_points
        Points that define a free datum; empty for all.
    relations
        Distances and height differences between points, by their index.
    positions, attitudes, mounting
        Observations of a GNSS antenna and an inertial unit, and how they are mounted.
    fiducial_fits
        How the fiducial marks fit, where the observations were given as readings.
    repetition
        How repeated readings agree, where the block has them.
    check_distances
        Known distances not used in the adjustment, by the index of their points.
    heads
        Cameras that are fixed to each other, the first of each frame among them.
    lasers
        Laser distances of images that are observations, by the index of images and points.
    global_test
        Its level and its kind.
    refraction
        Coefficient of atmospheric refraction; None where it is not modelled.
    curvature
        Whether local coordinates are plane, with heights above the curved earth.
    """

    name: str
    frame: str
    height: str
    datum: Literal["control", "free"]
    cameras: tuple[Camera, ...]
    images: Images
    points: ObjectPoints = NO_POINTS
    observations: Observations = NO_OBSERVATIONS
    inputs: tuple[InputFile, ...] = ()
    datum_points: tuple[str, ...] = ()
    relations: Relations = NO_RELATIONS
    positions: Positions = NO_POSITIONS
    attitudes: Attitudes = NO_ATTITUDES
    mounting: Mounting = NO_MOUNTING
    fiducial_fits: tuple[FiducialFit, ...] = ()
    repetition: Repetition | None = None
    global_test: tuple[float, Sided] = (0.95, "two-sided")
    check_distances: Relations = NO_RELATIONS
    heads: tuple[Head, ...] = ()
    refraction: float | None = None
    curvature: bool = False
    lasers: LaserDistances = NO_LASERS

    @staticmethod
    def read(path: str | Path) -> "Block":
        """Read a block folder; errors as of `block.folder.read_block`."""
        block: Block = import_module(_READER).read_block(Path(path))
        return block

    def write(self, path: str | Path) -> None:
        """Write a block folder that is equal when it is read; errors as of `block.writer.write_block`."""
        import_module(_WRITER).write_block(Path(path), self)

    def of_points(self, kept: Flags) -> "Block":
        """Keep some points, with the observations of them and between them."""
        place, seen = np.cumsum(kept) - 1, self.observations.rows(kept[self.observations.point])
        relations, checks = (
            part.moved(place).rows(np.append(kept, True)[part.ends].all(axis=1)) if len(part.kind) else part
            for part in (self.relations, self.check_distances)
        )
        points = self.points.only(kept)
        return replace(
            self,
            points=points,
            observations=replace(seen, point=place[seen.point]),
            relations=relations,
            check_distances=checks,
            lasers=self.lasers.of_points(place, kept),
            datum_points=tuple(name for name in self.datum_points if name in set(points.names)),
        )

    def of_images(self, kept: Flags) -> "Block":
        """Keep some images with all that was observed at their exposures, and the cameras that took them.

        Points stay; strips of positions are numbered anew.
        """
        place, seen = np.cumsum(kept) - 1, self.observations.rows(kept[self.observations.image])
        cameras, camera = np.unique(self.images.camera[kept], return_inverse=True)
        positions = self.positions.rows(kept[self.positions.image])
        attitudes = self.attitudes.rows(kept[self.attitudes.image])
        strip = np.unique(positions.strip, return_inverse=True)[1].astype(np.int64)
        return replace(
            self,
            cameras=tuple(self.cameras[k] for k in cameras),
            images=replace(self.images.some(np.flatnonzero(kept)), camera=camera.astype(np.int64)),
            observations=replace(seen, image=place[seen.image]),
            positions=replace(positions, image=place[positions.image], strip=strip),
            attitudes=replace(attitudes, image=place[attitudes.image]),
            lasers=self.lasers.of_images(place, kept),
        )

    def __repr__(self) -> str:
        """Say in one line what it holds."""
        roles = ", ".join(f"{int(self.points.of_role(role).sum())} {role}" for role in ROLES)
        return (
            f"Block {self.name}: {len(self.images.names)} images, {len(self.points.names)} points ({roles}), "
            f"{len(self.observations.image)} rays, {len(self.cameras)} camera(s), frame {self.frame}, "
            f"datum {self.datum}"
        )

    def _repr_html_(self) -> str:
        """A short table for a notebook."""
        of_role = {f"{role} points": int(self.points.of_role(role).sum()) for role in ROLES}
        counts = {"images": len(self.images.names), **of_role, "rays": len(self.observations.image)}
        shown = {**counts, "cameras": ", ".join(c.id for c in self.cameras), "frame": self.frame}
        shown["datum"] = self.datum
        rows = (f"<tr><td>{key}</td><td>{escape(str(value))}</td></tr>" for key, value in shown.items())
        return f"<p>Block {escape(self.name)}</p><table>{''.join(rows)}</table>"
