"""The camera: interior orientation parameters, their roles, and from pixels to the image plane."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from photocal.base.arrays import Flags, Floats
from photocal.base.errors import ConfigurationError
from photocal.base.extensions import LENSES, brought

# One of `MODELS`.
Model = str
Affinity = Literal["additive", "before", "after"]
AffinityForm = Literal["fraser", "canon-elph", "tank"]
DistortionAt = Literal["adjusted", "measured"]
Shutter = Literal["global", "rolling", "unknown"]
ReadoutDirection = Literal["top-to-bottom", "bottom-to-top", "left-to-right", "right-to-left"]

# Those of all lens models, and the readout; which of them a camera has, its model says.
PARAMETERS = (
    *("c", "x0", "y0", "K1", "K2", "K3", "K4", "P1", "P2", "P3", "P4", "B1", "B2"),
    *("K5", "K6", "S1", "S2", "S3", "S4", "readout"),
)
# Of one image: how the projection centre moves (m, object axes) and the camera turns (rad, its own axes)
# while it is read.
MOTION = ("move_X", "move_Y", "move_Z", "turn_x", "turn_y", "turn_z")
# Turns that come and go while it is read (rad, its own axes), as Legendre polynomials of the line.
SHAKE_DEGREES = (2, 3, 4, 5, 6)
SHAKE = tuple(f"shake{degree}_{axis}" for degree in SHAKE_DEGREES for axis in "xyz")
OWN = PARAMETERS + MOTION + SHAKE
# Millimetres in a metre: c is given in them, distances in metres.
MM = 1000.0


def among(*names: str) -> Flags:
    """Which of `PARAMETERS` have one of these names, shape (20,)."""
    return np.isin(PARAMETERS, names)


@dataclass(frozen=True)
class LensModel:
    """A lens model by its coefficients; the formulas are in `geometry.lens`.

    An installed package brings one under an entry point, whose name is that of the model:

        [project.entry-points."photocal.lenses"]
        toy = "toy_lens:LENS"

    terms: its coefficients beside c, x0, y0, B1, B2.
    relative: whether they belong to coordinates over c or to angles, and have no unit: such models distort
        the projection and have the affinity after it. Else to coordinates in the unit of the camera.
    angular: whether it is a function of the angle off the axis, and holds for more than 90 degrees.
    project: of a model of another package: a compiled function as those of `geometry.other_lenses`.
    """

    terms: tuple[str, ...]
    relative: bool = False
    angular: bool = False
    project: Callable[..., tuple[float, float]] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """All its parameters, in their order."""
        return tuple(n for n in PARAMETERS if n in {"c", "x0", "y0", *self.terms, "B1", "B2", "readout"})

    def power(self, name: str) -> int:
        """Power of a length in a parameter: 1 for c, -2 for K1 of Brown's polynomial."""
        coefficients = {"K1": -2, "K2": -4, "K3": -6, "K4": -8, "P1": -1, "P2": -1, "P3": -2, "P4": -4}
        return 1 if name in ("c", "x0", "y0") else 0 if self.relative else coefficients.get(name, 0)

    def powers(self) -> Floats:
        """Power of a length in each of `PARAMETERS`."""
        return np.array([self.power(name) for name in PARAMETERS], dtype=float)


_BROWN = LensModel(("K1", "K2", "K3", "K4", "P1", "P2", "P3", "P4"))
# The more usual ones first.
MODELS: dict[Model, LensModel] = {
    "brown-observed": _BROWN,
    "brown-ideal": _BROWN,
    "equidistant": LensModel(("K1", "K2", "K3", "K4"), relative=True, angular=True),
    "rational": LensModel(
        ("K1", "K2", "K3", "K4", "K5", "K6", "P1", "P2", "S1", "S2", "S3", "S4"), relative=True
    ),
    "pix4d-fisheye": LensModel(("K1", "K2", "K3"), relative=True, angular=True),
}
for _name, _lens in brought(LENSES, LensModel).items():
    if _name in MODELS or _lens.project is None or not _lens.relative:
        raise ConfigurationError(
            f"the lens {_name} cannot be used",
            "give it a name of its own, a function `project`, and terms without unit (relative=True)",
        )
    MODELS[_name] = _lens
AFFINITIES: tuple[Affinity, ...] = ("additive", "before", "after")

# Where B1 and B2 stand in the 2 x 2 matrix F of the affinity: F = B1 * first + B2 * second.
AFFINITY_MATRICES: dict[AffinityForm, tuple[list[list[float]], list[list[float]]]] = {
    "fraser": ([[1, 0], [0, 0]], [[0, 1], [0, 0]]),
    "canon-elph": ([[1, 0], [0, 0]], [[0, 0], [1, 0]]),
    "tank": ([[0, 1], [0, 0]], [[0, 0], [0, 1]]),
}


@dataclass(frozen=True, repr=False)
class Camera:
    """A camera and what is known of its interior orientation.

    Attributes
    ----------
    id
        Name within the block.
    model
        "brown-observed" and "brown-ideal" have Brown's polynomial, evaluated at the measured coordinates,
        which it corrects (photogrammetry), or at the ideal ones, which it distorts (vision).
    unit
        Of the image plane and so of c, x0, y0 and, in its powers, of the coefficients.
    size_px
        Width and height of the image.
    pitch
        Size of a pixel in x and y, in `unit`; (1, 1) when the unit is the pixel.
    values : array, shape (20,)
        In the order of `PARAMETERS`; the readout, from the first line to the last, in seconds.
    estimated : array, shape (20,)
        Which parameters the adjustment estimates; the others are held.
    prior_sigma : array, shape (20,)
        Standard deviation of the value as an observation; infinite where it is a start value only.
    reference_radius
        R0 of the balanced radial distortion, in `unit`; 0 for the unbalanced form.
    affinity
        Where the affinity acts.
    affinity_form
        Which terms B1 and B2 stand for.
    deviation_sigma : array, shape (20,)
        Photo-variant parameters: standard deviation by which the value of each image deviates from that
        of the camera, infinite for one that is free; 0 for block-invariant parameters.
    focus_m
        Distance at which the distortion holds, that to which the lens is focused: it then varies with the
        distance of the object; 0 where it is the same at all distances.
    prior_correlation : array, shape (20, 20)
        Correlations of the values as observations; None when they are independent.
    guessed
        Whether c is a guess: a start value that must not be held fixed.
    stated_by
        Name of the maker's tag that the values with a prior sigma come from; empty for other values.
    given : array, shape (20,)
        Of adjusted values: what they were before; else None.
    sigma : array, shape (20,)
        Standard deviations of adjusted values, 0 for held ones; None before an adjustment.
    correlation : array, shape (20, 20)
        Their correlations, 0 for held ones (1 on the diagonal); None before an adjustment.
    distortion_at
        Coordinates at which `brown-observed` evaluates its polynomial in an adjustment: the adjusted ones
        (Gauss-Helmert), or the measured ones with their errors, as older programs do.
    readout_direction
        In which order a rolling shutter reads the lines.
    shutter
        Whether all lines of an image have one exterior orientation; an unknown shutter is tested.
    gust
        By how much velocity (m/s) and rate (rad/s) of an image deviate from the known motion of the flight.
    shake
        Sigmas of the turns of an image during its readout (rad), by their degree from 1 on; empty
        without.
    """

    id: str
    model: Model
    unit: Literal["mm", "px"]
    size_px: tuple[int, int]
    pitch: tuple[float, float]
    values: Floats
    estimated: Flags
    prior_sigma: Floats
    reference_radius: float = 0.0
    affinity: Affinity = "additive"
    affinity_form: AffinityForm = "fraser"
    deviation_sigma: Floats = field(default_factory=lambda: np.zeros(len(PARAMETERS)))
    focus_m: float = 0.0
    prior_correlation: Floats | None = None
    guessed: bool = False
    stated_by: str = ""
    given: Floats | None = None
    sigma: Floats | None = None
    correlation: Floats | None = None
    distortion_at: DistortionAt = "adjusted"
    readout_direction: ReadoutDirection = "top-to-bottom"
    shutter: Shutter = "global"
    gust: tuple[float, float] = (0.5, 0.1)
    shake: tuple[float, ...] = ()

    def __repr__(self) -> str:
        width, height = self.size_px
        lines = [f"Camera {self.id}: {self.model}, {self.unit}, {width} x {height} px"]
        for name in self.used or ("c",):
            state = "estimated" if name in self.free else "held"
            known = f"+- {self.sigma_of(name):.3g}" if name in self.free and self.sigma is not None else state
            lines.append(f"  {name:<3}{self.value(name):>15.8g}  {known}")
        return "\n".join(lines)

    @property
    def lens(self) -> LensModel:
        """What its model is."""
        return MODELS[self.model]

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return tuple(name for name, chosen in zip(PARAMETERS, self.estimated, strict=True) if chosen)

    @property
    def used(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated or not zero."""
        chosen = self.estimated | (self.values != 0)
        return tuple(PARAMETERS[k] for k in np.flatnonzero(chosen))

    @property
    def photo_variant(self) -> tuple[str, ...]:
        """Names of the parameters that vary from image to image."""
        return tuple(PARAMETERS[k] for k in np.flatnonzero(self.deviation_sigma))

    def sigma_of(self, name: str) -> float:
        """Standard deviation of an adjusted parameter; 0 for one that is held."""
        return 0.0 if self.sigma is None else float(self.sigma[PARAMETERS.index(name)])

    def correlation_of(self, names: Sequence[str]) -> Floats:
        """Correlations of adjusted parameters, shape (n, n)."""
        rows = [PARAMETERS.index(name) for name in names]
        whole = np.eye(len(PARAMETERS)) if self.correlation is None else self.correlation
        return np.asarray(whole[np.ix_(rows, rows)])

    def covariance_of(self, names: Sequence[str]) -> Floats:
        """Covariance of adjusted parameters in products of their units, shape (n, n)."""
        sigma = [self.sigma_of(name) for name in names]
        return np.asarray(self.correlation_of(names) * np.outer(sigma, sigma))

    @property
    def rolling(self) -> bool:
        """Whether its shutter takes time to read an image, or may."""
        at = PARAMETERS.index("readout")
        return bool(self.estimated[at] or self.values[at])

    @property
    def shaken(self) -> float:
        """Root mean square by which vibration moves a coordinate within the readout, in the plane's unit."""
        squares = [s**2 / (2 * degree + 1) for degree, s in zip(SHAKE_DEGREES, self.shake[1:], strict=False)]
        return self.value("c") * float(np.sqrt(sum(squares)))

    def line_slope(self) -> tuple[float, float]:
        """Share of the readout by which a line is later, per unit of x and of y in the image plane."""
        if not self.rolling:
            return 0.0, 0.0
        across, down = (1 / (n * p) for n, p in zip(self.size_px, self.pitch, strict=True))
        return {
            "top-to-bottom": (0.0, -down),
            "bottom-to-top": (0.0, down),
            "left-to-right": (across, 0.0),
            "right-to-left": (-across, 0.0),
        }[self.readout_direction]

    def value(self, name: str) -> float:
        """Value of one parameter by its name."""
        return float(self.values[PARAMETERS.index(name)])

    def adjusted(self, values: ArrayLike, sigma: ArrayLike, correlation: ArrayLike) -> Self:
        """Return the same camera with adjusted values, their standard deviations and correlations."""
        return replace(
            self.with_values(values),
            given=self.values,
            sigma=np.asarray(sigma, dtype=float),
            correlation=np.where(np.eye(len(PARAMETERS)) > 0, 1.0, correlation),
        )

    def with_values(self, values: ArrayLike) -> Self:
        """Return the same camera with other parameter values, shape (20,)."""
        return replace(self, values=np.array(values, dtype=float))

    def changed(self, **values: float) -> Self:
        """Return the same camera with some values changed by name."""
        return self.with_values([values.get(n, v) for n, v in zip(PARAMETERS, self.values, strict=True)])


def camera(
    camera_id: str,
    model: Model,
    unit: Literal["mm", "px"],
    size_px: tuple[int, int],
    pitch: tuple[float, float],
    parameters: dict[str, float],
    *,
    estimate: tuple[str, ...] = (),
    prior_sigma: dict[str, float] | None = None,
    reference_radius: float = 0.0,
    affinity: Affinity | None = None,
    affinity_form: AffinityForm = "fraser",
    photo_variant: dict[str, float] | None = None,
    focus_m: float = 0.0,
) -> Camera:
    """Make a camera from named parameters; those not named are zero and held.

    Parameters
    ----------
    camera_id
        Name within the block.
    model
        "brown-observed" and "brown-ideal" have Brown's polynomial, evaluated at the measured coordinates,
        which it corrects (photogrammetry), or at the ideal ones, which it distorts (vision); "rational",
        "equidistant", "pix4d-fisheye".
    unit
        Of the image plane: of c, x0, y0 and, in its powers, of the coefficients; "mm" or "px".
    size_px
        Width and height of the image, px.
    pitch
        Size of a pixel in x and y, in `unit`; (1, 1) when the unit is the pixel.
    parameters
        Values by name: c, x0, y0, K1 ... K6, P1 ... P4, B1, B2, S1 ... S4, readout (s).
    estimate
        Names of the parameters that an adjustment estimates.
    prior_sigma
        Standard deviations of values that are observations; start values only where not given.
    reference_radius
        R0 of the balanced radial distortion, in `unit`; 0 for the unbalanced form.
    affinity
        Where the affinity acts; "additive" for Brown's models, "after" for the others where not given.
    affinity_form
        Which terms B1 and B2 stand for.
    photo_variant
        Standard deviations by which values of single images deviate from that of the camera.
    focus_m
        Distance to which the lens is focused, m, where its distortion varies with the distance; else 0.

    Returns
    -------
    Camera
        The camera.

    Raises
    ------
    ConfigurationError
        For a name that is not a parameter.

    References
    ----------
    D. C. Brown: Close-range camera calibration. Photogrammetric Engineering 37(8), 1971.

    Examples
    --------
    >>> import photocal
    >>> lens = photocal.camera("lens", "brown-ideal", "px", (4000, 3000), (1, 1), {"c": 3600.0, "K1": -8e-9})
    >>> lens.value("c")
    3600.0
    """
    index = {name: i for i, name in enumerate(PARAMETERS)}

    def row(named: dict[str, float] | None, other: float = 0.0) -> Floats:
        """Values by names in the order of `PARAMETERS`."""
        values = np.full(len(PARAMETERS), other)
        for name, value in (named or {}).items():
            if name not in index:
                raise ConfigurationError(
                    f"{name!r} is not a camera parameter", f"use {', '.join(PARAMETERS)}", where=camera_id
                )
            values[index[name]] = value
        return values

    return Camera(
        camera_id,
        model,
        unit,
        size_px,
        pitch,
        row(parameters),
        row(dict.fromkeys(estimate, 1.0)) > 0,
        row(prior_sigma, np.inf),
        reference_radius,
        affinity or ("after" if MODELS[model].relative else "additive"),
        affinity_form,
        row(photo_variant),
        focus_m,
    )


def held_camera(known: Camera) -> Camera:
    """Give a camera of which nothing is estimated, and nothing observed beforehand."""
    none = np.zeros_like(known.estimated)
    return replace(known, estimated=none, prior_sigma=np.full(len(none), np.inf))


def pixel_to_plane(size_px: ArrayLike, pitch: ArrayLike, pixel: Floats) -> Floats:
    """Turn pixel coordinates into image plane coordinates.

    size_px (..., 2): width and height of the image, px.
    pitch (..., 2): size of a pixel in x and y, in the unit of the image plane.
    pixel (..., 2): column and row; the centre of the upper-left pixel is (0, 0).
    returns (..., 2): x to the right, y up, from the middle of the image.
    """
    middle = (np.asarray(size_px, dtype=float) - 1) / 2
    return np.asarray((pixel - middle) * np.asarray(pitch) * [1.0, -1.0])


def plane_to_pixel(size_px: ArrayLike, pitch: ArrayLike, plane: Floats) -> Floats:
    """Turn image plane coordinates into pixel coordinates, the inverse of `pixel_to_plane`.

    size_px, pitch (..., 2): as in `pixel_to_plane`.
    plane (..., 2): x to the right, y up, from the middle of the image.
    returns (..., 2): column and row, px.
    """
    middle = (np.asarray(size_px, dtype=float) - 1) / 2
    return np.asarray(plane / np.asarray(pitch) * [1.0, -1.0] + middle)
