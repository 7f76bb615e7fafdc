"""The result of an adjustment: cameras, oriented images, points, residuals and what they are worth."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from photocal.adjustment.mounting import BORESIGHT
from photocal.adjustment.readout import Readout
from photocal.adjustment.rig import CENTRE, OF_HEAD, TURN
from photocal.adjustment.solution import ComponentFactor, Group
from photocal.base.arrays import Columns, Floats, Integers
from photocal.base.chi_square import GlobalTest
from photocal.base.errors import ConfigurationError
from photocal.base.files import output_folder
from photocal.base.tables import package
from photocal.block.model import InputFile, Repetition
from photocal.block.results.plot import Plots
from photocal.findings.texts import Catalogue, catalogue
from photocal.geometry.camera import MOTION, SHAKE, Camera
from photocal.geometry.oriented_images import OrientedImages

ANGLES, PLACE = ("omega", "phi", "kappa"), ("X", "Y", "Z")
TURNS, CENTRES = OF_HEAD[TURN], OF_HEAD[CENTRE]
# Named, not imported: it stands on this module.
_FOLDER = "photocal.block.results.folder"
# Radians and metres to what the tables have.
SHOWN = np.array([*np.degrees(np.ones(3)), 1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Software:
    """The program that made the results."""

    name: str
    version: str


@dataclass(frozen=True)
class BlockFacts:
    """What the adjusted block said of itself.

    source: the folder with its files, seen from the run folder.
    setup: the set-up file of another program within it; empty for a block folder.
    refraction, curvature: as the block states them.
    """

    name: str
    frame: str
    datum: str
    observation_unit: Literal["mm", "px"]
    observation_axes: Literal["pixel", "photo"]
    height: str = ""
    source: str = ""
    setup: str = ""
    refraction: float | None = None
    curvature: bool = False


@dataclass(frozen=True)
class CheckPoint:
    """Adjusted minus surveyed coordinates of a check point, m.

    sx, sy, sz: standard deviations of the adjusted coordinates.
    ux, uy, uz: of the surveyed ones; None where the block does not state them.
    """

    point: str
    dx: float
    dy: float
    dz: float
    sx: float
    sy: float
    sz: float
    ux: float | None = None
    uy: float | None = None
    uz: float | None = None


@dataclass(frozen=True)
class CheckLength:
    """A known distance that was not used: its value, adjusted minus known, and sigmas of both, m."""

    first: str
    second: str
    known: float
    error: float
    sigma: float
    known_sigma: float


@dataclass(frozen=True)
class CheckSummary:
    """Check points and their root mean square differences, m (none without points); check lengths."""

    n: int
    rmse_m: dict[str, float | None]
    points: tuple[CheckPoint, ...] = ()
    lengths: tuple[CheckLength, ...] = ()


@dataclass(frozen=True)
class MountingValue:
    """A value that is common to all exposures (lever arm, boresight, time offset ...), with its sigma."""

    value: float
    sigma: float
    estimated: bool


@dataclass(frozen=True)
class LaserShot:
    """A laser distance and its residual (computed minus measured), m; no w where nothing checks it."""

    image: str
    measured: float
    sigma: float
    residual: float
    redundancy: float
    w: float | None


@dataclass(frozen=True)
class AdjustedLasers:
    """Laser distances as observations: what they have in common, as the block finds it, and each of them."""

    offset_m: MountingValue
    scale: MountingValue
    shots: tuple[LaserShot, ...]


@dataclass(frozen=True)
class AdjustedHead:
    """A camera on a frame, relative to the one that the heads of the frame refer to.

    exposures: of which it has a picture together with another head.
    rotation_deg: rotation vector from the camera axes of `of` to its own.
    given_deg: the rotation from which the turns among `values` count.
    values: by `adjustment.rig.OF_HEAD`: turns about its own axes (deg) from `given_deg`, projection centre in
        the camera axes of `of` (m), and the time by which it exposes later (s).
    prior: what was given for them, with its sigma (none where nothing was known; 0 where it is held).
    correlation: of those that are estimated, in their order.
    lag: time and its sigma (s) for which gusts move the frame in its relations.
    common, registration_px: rays that both show of one exposure, and the root mean square by which this
        camera's pictures miss those of `of` there, px of this camera (none without such rays).
    """

    camera: str
    of: str
    exposures: int
    rotation_deg: tuple[float, float, float]
    given_deg: tuple[float, float, float]
    values: dict[str, MountingValue]
    prior: dict[str, tuple[float, float | None]]
    correlation: tuple[tuple[float, ...], ...]
    lag: tuple[float, float] | None = None
    common: int = 0
    registration_px: float | None = None

    @property
    def free(self) -> tuple[str, ...]:
        """Names of what is estimated."""
        return tuple(name for name, value in self.values.items() if value.estimated)

    def covariance(self, names: Sequence[str] | None = None) -> Floats:
        """Covariance (deg, m, s) of what is estimated, or of all `names` with zeros for the rest."""
        free, wanted = self.free, self.free if names is None else tuple(names)
        sigma = np.array([self.values[name].sigma for name in free])
        estimated = np.array(self.correlation).reshape(len(free), len(free)) * np.outer(sigma, sigma)
        whole = np.zeros((len(wanted), len(wanted)))
        at = [wanted.index(name) for name in free if name in wanted]
        some = [k for k, name in enumerate(free) if name in wanted]
        whole[np.ix_(at, at)] = estimated[np.ix_(some, some)]
        return whole


@dataclass(frozen=True)
class RejectedRay:
    """An observation that is not used because data snooping found it wrong."""

    image: str
    point: str


@dataclass(frozen=True, eq=False)
class AdjustedPoints:
    """Object points of the network.

    values (n, 3): X, Y, Z in the block's coordinates, m.
    """

    names: tuple[str, ...]
    role: tuple[str, ...]
    values: Floats
    covariance: Floats
    rays: Integers

    @cached_property
    def sigma(self) -> Floats:
        """Standard deviations, m, shape (n, 3)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))


@dataclass(frozen=True, eq=False)
class Residuals(Columns):
    """Image observations and their residuals (computed minus measured), in unit and axes of the observations.

    measured, residual (n, 2): NaN residuals where an observation was not used.
    redundancy, standardised (n, 2): redundancy numbers (0 to 1) and standardised residuals; NaN where nothing
        else checks one.
    """

    image_names: tuple[str, ...]
    point_names: tuple[str, ...]
    image: Integers
    point: Integers
    measured: Floats
    residual: Floats
    redundancy: Floats
    standardised: Floats

    def __len__(self) -> int:
        return len(self.image)

    @cached_property
    def accepted(self) -> Self:
        """Those that took part."""
        return self.rows(np.flatnonzero(np.isfinite(self.residual).all(axis=1)))

    def rms(self) -> tuple[Integers, Floats]:
        """Accepted rays of each image, shape (images,), and root mean square residuals, (images, 2)."""
        part = self.accepted
        count = np.bincount(part.image, minlength=len(self.image_names))
        squares = [np.bincount(part.image, part.residual[:, a] ** 2, len(count)) for a in range(2)]
        return count, np.asarray(np.sqrt(np.column_stack(squares) / np.maximum(count, 1)[:, None]))


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Figures of the whole adjustment; without redundancy there is no variance factor and no test.

    snooping: test by which gross errors were searched.
    readouts: of shutters that roll, or were tested.
    unobserved: points of the block without an observation.
    mounting: lever arm (camera to antenna, body axes, m), boresight (deg), time offset (s), shifts and
        drifts.
    heads: cameras on a frame, but for those that the others refer to.
    lasers: where distances are observations.
    mean_precision_m, control_residuals, fiducials, ellipses, reliability: what was asked for beside the
        rest, as in `result.json`.
    """

    software: Software
    block: BlockFacts
    inputs: tuple[InputFile, ...]
    converged: bool
    iterations: int
    observations: int
    unknowns: int
    degrees_of_freedom: int
    chi_squared: float
    sigma0_squared: float | None
    global_test: GlobalTest | None
    groups: tuple[Group, ...]
    checks: CheckSummary
    snooping: Literal["w", "tau"] | None = None
    mounting: dict[str, MountingValue] | None = None
    heads: tuple[AdjustedHead, ...] = ()
    lasers: AdjustedLasers | None = None
    variance_components: tuple[ComponentFactor, ...] = ()
    readouts: tuple[Readout, ...] = ()
    rejected: tuple[RejectedRay, ...] = ()
    unobserved: tuple[str, ...] = ()
    fiducials: tuple[dict[str, Any], ...] = ()
    repetition: Repetition | None = None
    mean_precision_m: dict[str, Any] = field(default_factory=dict)
    control_residuals: dict[str, float | None] | None = None
    ellipses: dict[str, float] | None = None
    reliability: dict[str, float] | None = None

    @property
    def scale(self) -> float | None:
        """By what a rejected global test multiplies standard deviations; None where it does not."""
        test = self.global_test
        return math.sqrt(self.sigma0_squared) if test and not test.accepted and self.sigma0_squared else None


def common_values(mounting: Mapping[str, MountingValue] | None, given: Floats) -> Floats:
    """Common values of `adjustment.mounting` (m, rad, s) as they were adjusted, else as given."""
    if mounting is None:
        return given
    values = given.copy()
    values[: len(mounting)] = [value.value for value in mounting.values()]
    values[BORESIGHT] = np.radians(values[BORESIGHT])
    return values


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Result(Figures):
    """The result of an adjustment.

    Attributes
    ----------
    cameras
        Adjusted cameras by name, with sigmas and correlations.
    images
        In the block's coordinates, with covariances; their cameras are those of `cameras`.
    residuals
        One for each observation of the block, in its order.
    files
        The files of the run folder that this was read from.
    """

    cameras: dict[str, Camera]
    images: OrientedImages
    points: AdjustedPoints
    residuals: Residuals
    files: tuple[InputFile, ...] = ()

    @staticmethod
    def read(path: str | Path) -> "Result":
        """Read a run folder; errors as of `results.folder.read_result`."""
        result: Result = import_module(_FOLDER).read_result(Path(path))
        return result

    def write(self, path: str | Path) -> None:
        """Write a run folder; an interrupted write leaves no incomplete result."""
        with output_folder(Path(path)) as aside:
            import_module(_FOLDER).write_result(aside, self)

    def __repr__(self) -> str:
        """What a person wants to know first."""
        return self.text(catalogue("en"))

    def text(self, say: Catalogue) -> str:
        """The main figures as text in a language."""
        counts = {name: getattr(self, name) for name in ("iterations", "observations", "unknowns")}
        freedom = self.degrees_of_freedom
        lines = [say("result.head", block=self.block.name, **counts, freedom=freedom)]
        if self.sigma0_squared is not None or self.global_test:
            lines.append(self._test_text(say))
        if self.repetition is not None:
            r, unit = self.repetition, self.block.observation_unit
            sigmas = None if r.sigma is None else {"x": float(r.sigma[0]), "y": float(r.sigma[1])}
            spread = "" if sigmas is None else say.told("result.spread", **sigmas, unit=unit)
            kept = {"readings": r.readings, "rejected": r.rejected, "least": r.least, "most": r.most}
            lines.append(say.told("result.readings", **kept, limit=float(r.limit), unit=unit, spread=spread))
        for name, camera in self.cameras.items():
            lines.append(say("result.camera", camera=name, model=camera.model, unit=camera.unit))
            lines += [
                f"  {key:<3}{say.row([camera.value(key)], '>15.8g')}  +- "
                f"{self._sigmas(camera.sigma_of(key), say)}"
                for key in camera.free
            ]
        for readout in self.readouts:
            sizes = {"readout": 1e3 * readout.value, "sigma": 1e3 * readout.sigma, "effect": readout.effect}
            kind = say("result.rolling" if readout.estimated else "result.global")
            more = {"way": readout.way, "p": readout.p_value}
            unit = self.cameras[readout.camera].unit
            lines.append(
                say.told("result.shutter", camera=readout.camera, kind=kind, unit=unit, **sizes, **more)
            )
        lines += [_head_text(head, say) for head in self.heads]
        lines += [
            say.told("result.component", name=component.name, factor=component.factor, sigma=component.sigma)
            for component in self.variance_components
            if component.sigma is not None
        ]
        return "\n".join([*lines, *self._points_text(say)])

    def _test_text(self, say: Catalogue) -> str:
        """Say the global test."""
        chi, factor = self.chi_squared, self.sigma0_squared
        if not (test := self.global_test):
            return say.told("result.unclaimed", chi=chi, factor=factor)
        verdict = say("result.accepted" if test.accepted else "result.rejected")
        span = {"lower": test.lower, "upper": test.upper, "probability": test.probability}
        return say.told("result.test", chi=chi, factor=factor, **span, verdict=verdict)

    def _points_text(self, say: Catalogue) -> list[str]:
        """Say the precision of the points, and what control and checks show."""
        lines = list[str]()
        mean = self.mean_precision_m
        if mean.get("proportional"):
            sizes = {"sigma": 1e3 * mean["arithmetic"], "range": 1e3 * mean["spread"]}
            lines.append(say.told("result.points", **sizes, parts=float(mean["proportional"])))
        control = self.control_residuals
        if control is not None and control["rmse_m"] is not None:
            expected = control["expected_at_check_points_m"]
            more = "" if expected is None else say.told("result.hottier", expected=1e3 * expected)
            rmse_mm = 1e3 * control["rmse_m"]
            lines.append(say.told("result.control", n=int(control["n"] or 0), rmse=rmse_mm, more=more))
        if self.rejected:
            lines.append(say("result.gross", n=len(self.rejected)))
        if self.checks.n:
            rmse = [(axis, value) for axis, value in self.checks.rmse_m.items() if value is not None]
            cells = (f"{axis} {say.row([value * 1000], '.1f')}" for axis, value in rmse)
            lines.append(say("result.checks", n=self.checks.n, rmse=say("join.figures").join(cells)))
        if self.checks.lengths:
            lengths = self.checks.lengths
            worst = 1e3 * max(abs(length.error) for length in lengths)
            lines.append(say.told("result.lengths", n=len(lengths), worst=worst))
        return lines

    def _sigmas(self, sigma: float, say: Catalogue | None = None) -> str:
        """A standard deviation a priori, and scaled where the global test rejects that."""
        say = say or catalogue("en")
        if self.scale is None:
            return say.row([sigma], ".3g")
        return say.told("result.scaled", sigma=float(sigma), scaled=float(self.scale * sigma))

    def tables(self) -> dict[str, Any]:
        """Images, points and residuals as Arrow tables, as in the run folder (degrees, m, unit of rays)."""
        import pyarrow as pa

        images, points, rays = self.images, self.points, self.residuals
        values, sigma = images.values * SHOWN, images.sigma * SHOWN
        of_images: dict[str, Any] = {
            "image": pa.array(images.names, pa.string()),
            "camera": pa.array([images.cameras[k].id for k in images.camera], pa.string()),
        }
        for kind, prefix in ((values, ""), (sigma, "s")):
            for k, name in enumerate(PLACE):
                of_images[prefix + name] = kind[:, 3 + k]
            for k, name in enumerate(ANGLES):
                of_images[prefix + name[0] if prefix else name] = kind[:, k]
        if images.movement is not None:
            shown = np.r_[SHOWN[::-1], np.full(len(SHAKE), SHOWN[0])][: images.movement.shape[1]]
            of_images |= dict(zip(MOTION + SHAKE, (images.movement * shown).T, strict=False))
        of_points: dict[str, Any] = {
            "point": pa.array(points.names, pa.string()),
            "role": pa.array(points.role, pa.string()),
            **{name: points.values[:, k] for k, name in enumerate(PLACE)},
            **{f"s{name}": points.sigma[:, k] for k, name in enumerate(PLACE)},
            "rays": points.rays,
        }
        columns = {
            name: pa.DictionaryArray.from_arrays(rows, pa.array(names, pa.string())).dictionary_decode()
            for name, rows, names in (
                ("image", rays.image, rays.image_names),
                ("point", rays.point, rays.point_names),
            )
        }
        columns |= {axis: rays.measured[:, k] for k, axis in enumerate("xy")}
        for name, pair in (("v", rays.residual), ("r", rays.redundancy), ("w", rays.standardised)):
            for k, axis in enumerate("xy"):
                # Of an observation that is not used, or that no other checks, cells are empty.
                columns[name + axis] = pa.array(pair[:, k], from_pandas=True)
        return {"images": pa.table(of_images), "points": pa.table(of_points), "residuals": pa.table(columns)}

    def camera(self, name: str = "") -> Camera:
        """Give an adjusted camera.

        Parameters
        ----------
        name
            Its name; may be left out where there is one only.

        Returns
        -------
        Camera
            The camera with standard deviations and correlations of its parameters.

        Raises
        ------
        ConfigurationError
            For a name that no camera has, or no name where there are several; the message names them.
        """
        if not name and len(self.cameras) == 1:
            return next(iter(self.cameras.values()))
        if name not in self.cameras:
            what = f"there is no camera {name!r}" if name else "there are several cameras"
            raise ConfigurationError(what, f"name one of {', '.join(self.cameras)}", where=self.block.name)
        return self.cameras[name]

    @property
    def plot(self) -> Plots:
        """Pictures: `.residuals()`, `.camera()`, `.block()`; each returns a matplotlib figure."""
        return Plots(self)

    def to_pandas(self) -> dict[str, Any]:
        """Give images, points and residuals as DataFrames.

        Returns
        -------
        dict of pandas.DataFrame
            The tables of `tables`, with the same columns and units.

        Raises
        ------
        ProgramMissingError
            When pandas is not installed.
        """
        package("pandas")
        return {name: table.to_pandas() for name, table in self.tables().items()}

    def _repr_html_(self) -> str:
        """A short table for a notebook: the verdict, then the parameters of each camera."""
        first, *_ = repr(self).splitlines()
        rows = [
            f"<tr><td>{escape(name)}</td><td>{key}</td><td>{camera.value(key):.8g}</td>"
            f"<td>{self._sigmas(camera.sigma_of(key))}</td><td>{camera.unit}</td></tr>"
            for name, camera in self.cameras.items()
            for key in camera.free
        ]
        test = self.global_test
        verdict = f", global test {'accepted' if test.accepted else 'REJECTED'}" if test else ""
        if test is None and self.degrees_of_freedom > 0:
            verdict = ", global test not claimed"
        head = "<tr><th>camera</th><th>parameter</th><th>value</th><th>sigma</th><th>unit of c</th></tr>"
        return f"<p>{escape(first)}{verdict}</p><table>{head}{''.join(rows)}</table>"

    def images_of(self, camera: str) -> Integers:
        """Which images a camera took."""
        return np.flatnonzero(self.images.camera == list(self.cameras).index(camera))

    @cached_property
    def observed(self) -> Integers:
        """Which adjusted point each observed one is; -1 for those that were not adjusted."""
        place = {name: j for j, name in enumerate(self.points.names)}
        return np.array([place.get(name, -1) for name in self.residuals.point_names], dtype=np.int64)

    def residuals_of(self, camera: str) -> Residuals:
        """Accepted observations in the images of a camera."""
        part = self.residuals.accepted
        return part.rows(np.flatnonzero(np.isin(part.image, self.images_of(camera))))


def _head_text(head: AdjustedHead, say: Catalogue) -> str:
    """Say where a camera of a frame is."""
    turns, place, later = (
        " ".join(
            f"{factor * head.values[key].value:.4g} +- {factor * head.values[key].sigma:.2g}" for key in keys
        ).replace(".", say.mark)
        for keys, factor in ((TURNS, 3600.0), (CENTRES, 1000.0), (("time",), 1000.0))
    )
    both = say.told("result.both", n=head.common, apart=head.registration_px) if head.common else ""
    who = {"camera": head.camera, "of": head.of, "exposures": head.exposures}
    return say("result.head_of", **who, place=place, turns=turns, later=later, both=both)
