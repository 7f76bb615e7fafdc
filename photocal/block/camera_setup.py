"""`[[camera]]`: what a block or a project says of a camera, checked key by key.

Another calibration as prior of a camera: values, standard deviations and correlations of its file.
"""

import json
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, AliasChoices, Field, FiniteFloat, PositiveFloat

from photocal.base.arrays import Flags, Floats
from photocal.base.checked_toml import Table, checked_tables
from photocal.base.codec import as_degrees
from photocal.base.errors import ConfigurationError, InputNotFoundError
from photocal.geometry.camera import (
    MM,
    MODELS,
    PARAMETERS,
    Affinity,
    AffinityForm,
    Camera,
    DistortionAt,
    ReadoutDirection,
    Shutter,
    among,
    camera,
)
from photocal.geometry.distortion import focused


class _Parameter(Table, extra="ignore"):
    value: float
    sigma: float | None = None
    estimated: bool = False


class CorrelationKeys(Table):
    """Correlations between parameters."""

    names: tuple[str, ...]
    matrix: tuple[tuple[FiniteFloat, ...], ...]


class StoredCalibration(Table, extra="ignore"):
    """What the file of a calibration says of a camera."""

    model: str
    unit: str
    size_px: tuple[int, int]
    affinity: str = "additive"
    affinity_form: str = "fraser"
    distortion_at: str = "adjusted"
    reference_radius: float = 0.0
    parameters: dict[str, _Parameter]
    correlation: CorrelationKeys

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters that were estimated, in the order of the correlations."""
        known = self.parameters
        return tuple(n for n in self.correlation.names if known[n].estimated and known[n].sigma)


def read_prior(path: Path, camera: str) -> StoredCalibration:
    """Read the calibration of a camera: of that name, or the only one.

    path: what a run or a certificate wrote as JSON.
    raises InputNotFoundError, ConfigurationError: when there is none.
    """
    if not path.is_file():
        raise InputNotFoundError("does not exist", "name the result.json of a calibration", where=path)
    wrong = ConfigurationError.at(path)
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        cameras: dict[str, Any] = (content.get("result") or content)["cameras"]
        chosen = cameras[camera] if camera in cameras or len(cameras) != 1 else next(iter(cameras.values()))
    except (ValueError, KeyError, TypeError, AttributeError):
        raise wrong(f"has no calibration of camera {camera}", "name that of this camera") from None
    made = checked_tables(chosen, StoredCalibration, path)
    if set(made.correlation.names) - set(made.parameters):
        raise wrong("has correlations of other parameters", "is it the file that photocal wrote?")
    return made


def prior_keys(made: StoredCalibration) -> dict[str, Any]:
    """Give values, their meaning, estimate, prior sigmas and correlations in the keys of a `[[camera]]`."""
    free = made.free
    at = [made.correlation.names.index(name) for name in free]
    matrix = tuple(tuple(made.correlation.matrix[i][j] for j in at) for i in at)
    return {
        "affinity": made.affinity,
        "affinity_form": made.affinity_form,
        "distortion_at": made.distortion_at,
        "R0": made.reference_radius,
        "parameters": {name: one.value for name, one in made.parameters.items() if one.value},
        "estimate": free,
        "prior_sigma": {name: made.parameters[name].sigma for name in free},
        "prior_correlation": {"names": free, "matrix": matrix},
    }


# Film of 23 cm that was scanned to 2.3 micrometres; the size of a picture itself is limited further.
LARGEST_SIDE_PX = 100_000
Side = Annotated[int, Field(gt=0, le=LARGEST_SIDE_PX)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
Deviation = NonNegative | Literal["free"]
# A sigma, one for each axis, or "free" for an unknown without prior knowledge.
Sigma = Deviation | tuple[Deviation, Deviation, Deviation]
RADIAL = ("K1", "K2", "K3", "K4")


def _known_model(name: str) -> str:
    if name not in MODELS:
        raise ValueError(f"must be one of {', '.join(MODELS)}")
    return name


def sigmas(given: Sigma) -> Floats:
    """Give the sigmas of three axes; infinite where they are free."""
    each = given if isinstance(given, tuple) else (given,) * 3
    return np.array([np.inf if one == "free" else one for one in each])


def sigma_keys(values: ArrayLike) -> Sigma:
    """Give the key of sigmas, the inverse of `sigmas`."""
    each: list[Deviation] = ["free" if np.isinf(one) else float(one) for one in np.ravel(values)]
    return each[0] if len(set(each)) == 1 else (each[0], each[1], each[2])


class FocusCalibrationKeys(Table):
    """Radial distortion at one distance of focus; `inf` is a distance too."""

    distance_m: Annotated[float, Field(gt=0, allow_inf_nan=True)]
    K1: FiniteFloat = 0.0
    K2: FiniteFloat = 0.0
    K3: FiniteFloat = 0.0
    K4: FiniteFloat = 0.0


class FocusKeys(Table):
    """`focus`: distortion that varies with the distance of the object."""

    distance_m: PositiveFloat
    calibrations: Annotated[tuple[FocusCalibrationKeys, ...], Field(max_length=2)] = ()


class GustKeys(Table):
    """`gust`: by how much an image's motion departs from what is known of the flight."""

    velocity_m_s: NonNegative = 0.5
    rate_deg_s: NonNegative = 6.0


class CameraKeys(Table):
    """One `[[camera]]`, of a block or of a file of calibrations.

    prior_correlation: between the parameters with a prior sigma.
    prior_from: result.json or certificate.json of another calibration, relative to this file:
        its values, standard deviations and all its correlations are the prior.
    shake_rad: sigmas of the turns of an image during its readout, by their degree from 1 on.
    sigma, correlation: of values that were adjusted; `given`: what those were before.
    """

    id: str
    model: Annotated[str, AfterValidator(_known_model)]
    unit: Literal["mm", "px"]
    size_px: tuple[Side, Side]
    pitch_mm: PositiveFloat | tuple[PositiveFloat, PositiveFloat] | None = None
    parameters: dict[str, FiniteFloat] = Field(default={})
    estimate: tuple[str, ...] = ()
    prior_sigma: dict[str, NonNegative] = Field(default={})
    R0: NonNegative = Field(default=0.0, validation_alias=AliasChoices("R0", "reference_radius"))
    affinity: Affinity | None = None
    affinity_form: AffinityForm = "fraser"
    distortion_at: DistortionAt = "adjusted"
    shutter: Shutter | None = None
    readout_direction: ReadoutDirection = "top-to-bottom"
    readout_from: str = ""
    gust: GustKeys = Field(default_factory=lambda: GustKeys())
    photo_variant: dict[str, PositiveFloat | Literal["free"]] = Field(default={})
    focus: FocusKeys | None = None
    guessed: bool = False
    stated_by: str = ""
    prior_correlation: CorrelationKeys | None = None
    prior_from: str = ""
    shake_rad: tuple[NonNegative, ...] = ()
    sigma: dict[str, PositiveFloat] | None = None
    correlation: CorrelationKeys | None = None
    given: dict[str, FiniteFloat] | None = None


def make_camera(keys: CameraKeys, where: object) -> Camera:
    """Make the camera that a `[[camera]]` describes.

    raises ConfigurationError: for unknown parameters, a missing pitch or principal distance, or sigmas that
        do not fit.
    """
    keys = with_prior(keys, where)
    made = camera_of(keys, where)
    wrong = ConfigurationError.at(f"{where}, camera {keys.id}")
    weighted = [name for name, sigma in keys.prior_sigma.items() if sigma > 0]
    idle = [name for name in weighted if name not in keys.estimate]
    if idle:
        raise wrong(f"{idle[0]} has a prior sigma but is not estimated", "list it in estimate")
    for name, deviation in keys.photo_variant.items():
        if deviation == "free" and name in keys.estimate and name not in weighted:
            raise wrong(
                f"{name} is free in every image, so the camera has no common value",
                "take it out of estimate, or give photo_variant a standard deviation",
            )
    rolling, varies = made.shutter == "rolling", "readout" in keys.photo_variant
    if varies or (rolling and keys.shutter not in (None, "rolling")):
        what = "varies from image to image" if varies else f"has a {keys.shutter} shutter"
        raise wrong(f"the readout {what}", 'give shutter = "rolling", and one readout for all images')
    if keys.shutter == "rolling" and not (made.rolling or "readout" in keys.parameters):
        raise wrong(
            "a rolling shutter has neither a readout in parameters nor in estimate",
            'add "readout" (s) to one of them, or give shutter = "unknown" to have it tested',
        )
    return made


def with_prior(keys: CameraKeys, where: object) -> CameraKeys:
    """Take the prior of a camera from the calibration that it names; errors as of `make_camera`."""
    if not keys.prior_from:
        return keys
    wrong = ConfigurationError.at(f"{where}, camera {keys.id}")
    twice = [name for name in ("parameters", "prior_sigma", "prior_correlation") if getattr(keys, name)]
    if twice:
        raise wrong(f"prior_from and {twice[0]} are both given", "remove one of them")
    folder = Path(where).parent if isinstance(where, Path) else Path()
    prior = read_prior(folder / keys.prior_from, keys.id)
    for what in ("model", "unit", "size_px"):
        theirs, own = getattr(prior, what), getattr(keys, what)
        if theirs != own:
            raise wrong(f"{what} is {own}, that of prior_from {theirs}", "name a calibration of this camera")
    taken = prior_keys(prior)
    if keys.estimate:
        held = [name for name in taken["estimate"] if name not in keys.estimate]
        if held:
            raise wrong(
                f"estimate lacks {held[0]}, correlated with the others",
                "estimate all parameters of prior_from, or leave estimate out",
            )
        taken["estimate"] = keys.estimate
    return CameraKeys.model_validate({**keys.model_dump(by_alias=False), **taken, "prior_from": ""})


def _require(keys: CameraKeys, wrong: Callable[..., ConfigurationError]) -> None:
    """Refuse what the model of a camera does not have, and what every camera must have."""
    lens = MODELS[keys.model]
    correlated = [some.names for some in (keys.prior_correlation, keys.correlation) if some is not None]
    sections: dict[str, Iterable[str]] = {
        **{key: getattr(keys, key) for key in ("parameters", "estimate", "prior_sigma", "photo_variant")},
        "sigma": keys.sigma or (),
        "given": keys.given or (),
        "correlation": [name for names in correlated for name in names],
    }
    for section, names in sections.items():
        unknown = [name for name in names if name not in lens.names]
        if unknown:
            raise wrong(
                f"{section} names {unknown[0]}, which is not a camera parameter of {keys.model}",
                f"use {', '.join(lens.names)}",
            )
    if lens.relative and (keys.R0 or keys.focus or keys.affinity not in (None, "after")):
        raise wrong(
            f"{keys.model} has neither R0 nor focus, and its affinity is after the distortion",
            "remove R0, focus and affinity, or take a model of Brown",
        )
    if not keys.parameters.get("c", 0.0) > 0:
        raise wrong("the principal distance c is missing or not positive", "give c in parameters")
    if keys.unit == "mm" and keys.pitch_mm is None:
        raise wrong("pitch_mm is missing", 'give the pixel pitch, or unit = "px"')


def camera_of(keys: CameraKeys, where: object) -> Camera:
    """Make the camera of keys whose parameters had their roles before; errors as of `make_camera`."""
    place = f"{where}, camera {keys.id}"
    _require(keys, ConfigurationError.at(place))
    pitch = keys.pitch_mm if isinstance(keys.pitch_mm, tuple) else (keys.pitch_mm or 1.0,) * 2
    # A prior sigma of 0 holds the parameter, as it does for coordinates.
    interior = camera(
        keys.id,
        keys.model,
        keys.unit,
        keys.size_px,
        (1.0, 1.0) if keys.unit == "px" else pitch,
        keys.parameters,
        estimate=tuple(name for name in keys.estimate if keys.prior_sigma.get(name) != 0),
        prior_sigma={name: sigma for name, sigma in keys.prior_sigma.items() if sigma > 0},
        reference_radius=keys.R0,
        affinity=keys.affinity,
        affinity_form=keys.affinity_form,
        photo_variant={
            name: np.inf if deviation == "free" else deviation
            for name, deviation in keys.photo_variant.items()
        },
        focus_m=0.0 if keys.focus is None else keys.focus.distance_m,
    )
    interior = _with_known_readout(keys, place, _focused(keys, place, interior))
    rolling = interior.rolling or "readout" in keys.parameters
    return replace(
        interior,
        guessed=keys.guessed,
        stated_by=keys.stated_by,
        distortion_at=keys.distortion_at,
        shutter="rolling" if rolling else keys.shutter or "global",
        readout_direction=keys.readout_direction,
        gust=(keys.gust.velocity_m_s, float(np.radians(keys.gust.rate_deg_s))),
        shake=keys.shake_rad,
        prior_correlation=_matrix(keys.prior_correlation, place),
        given=_row(keys.given),
        sigma=_row(keys.sigma),
        correlation=_matrix(keys.correlation, place),
    )


def _row(named: dict[str, float] | None) -> Floats | None:
    return None if named is None else np.array([named.get(name, 0.0) for name in PARAMETERS])


def _matrix(keys: CorrelationKeys | None, place: str) -> Floats | None:
    """Correlations of all parameters; those that are not named have none."""
    if keys is None:
        return None
    count = len(keys.names)
    if [len(row) for row in keys.matrix] != [count] * count:
        raise ConfigurationError(
            f"correlation matrix is not {count} by {count}", "give every row in full", where=place
        )
    at = [PARAMETERS.index(name) for name in keys.names]
    whole = np.eye(len(PARAMETERS))
    whole[np.ix_(at, at)] = np.array(keys.matrix).reshape(count, count)
    return whole


def camera_keys(camera: Camera) -> CameraKeys:
    """Say a camera in the keys of `[[camera]]`, the inverse of `make_camera`.

    The prior sigma of a parameter that is held means nothing and is left out.
    """
    prior = np.where(camera.estimated, camera.prior_sigma, np.inf)
    velocity, rate = camera.gust
    return CameraKeys(
        id=camera.id,
        model=camera.model,
        unit=camera.unit,
        size_px=camera.size_px,
        pitch_mm=camera.pitch if camera.unit == "mm" else None,
        parameters=_named(camera.values, (camera.values != 0) | among("c")),
        estimate=camera.free,
        prior_sigma=_named(prior, np.isfinite(prior)),
        R0=camera.reference_radius,
        affinity=camera.affinity,
        affinity_form=camera.affinity_form,
        distortion_at=camera.distortion_at,
        shutter=None if camera.shutter == "global" else camera.shutter,
        readout_direction=camera.readout_direction,
        gust=GustKeys(velocity_m_s=velocity, rate_deg_s=float(as_degrees(rate))),
        photo_variant={
            name: "free" if np.isinf(deviation) else deviation
            for name, deviation in _named(camera.deviation_sigma, camera.deviation_sigma != 0).items()
        },
        focus=FocusKeys(distance_m=camera.focus_m) if camera.focus_m else None,
        guessed=camera.guessed,
        stated_by=camera.stated_by,
        prior_correlation=_correlation_keys(camera.prior_correlation),
        shake_rad=camera.shake,
        sigma=None if camera.sigma is None else _named(camera.sigma, camera.sigma != 0),
        correlation=_correlation_keys(camera.correlation, camera.sigma),
        given=None if camera.given is None else _named(camera.given, camera.given != 0),
    )


def _named(values: Floats, chosen: Flags) -> dict[str, float]:
    return {PARAMETERS[k]: float(values[k]) for k in np.flatnonzero(chosen)}


def _correlation_keys(whole: Floats | None, sigma: Floats | None = None) -> CorrelationKeys | None:
    if whole is None:
        return None
    known = np.zeros(len(whole), dtype=np.bool_) if sigma is None else sigma != 0
    at = np.flatnonzero(known | (whole != np.eye(len(whole))).any(axis=1))
    rows = tuple(map(tuple, whole[np.ix_(at, at)].tolist()))
    return CorrelationKeys(names=tuple(PARAMETERS[k] for k in at), matrix=rows)


def _with_known_readout(keys: CameraKeys, place: str, interior: Camera) -> Camera:
    """Take the readout of a known camera; estimated, it is an observation with the table's sigma."""
    if not keys.readout_from:
        return interior
    wrong = ConfigurationError.at(place)
    if "readout" in keys.parameters:
        raise wrong("readout_from and a readout in parameters are both given", "remove one of them")
    try:
        known, sigma = known_readout(keys.readout_from, keys.size_px)
    except ConfigurationError as refusal:
        raise wrong(refusal.what, refusal.remedy) from refusal
    at = among("readout")
    weighted = at & interior.estimated & np.isinf(interior.prior_sigma)
    prior_sigma = np.where(weighted, sigma, interior.prior_sigma)
    return replace(interior, values=np.where(at, known, interior.values), prior_sigma=prior_sigma)


def known_readout(make_and_model: str, size_px: tuple[int, int]) -> tuple[float, float]:
    """Readout of a known camera and its sigma, s."""
    table = tomllib.loads(resources.files("photocal.block").joinpath("readouts.toml").read_text("utf-8"))
    known = table["ms"].get(make_and_model.lower())
    if isinstance(known, list):
        known = next((ms for *size, ms in known if tuple(size) == size_px), None)
    if known is None:
        raise ConfigurationError(
            f"nothing is known of the readout of {make_and_model!r} at this size",
            "give readout in parameters (s), or one of " + ", ".join(table["ms"]),
        )
    return known / 1e3, table["sigma_ms"] / 1e3


def _focused(keys: CameraKeys, place: str, interior: Camera) -> Camera:
    """Give a camera the distortion of its focus from calibrations at two others."""
    if keys.focus is None:
        return interior
    wrong = ConfigurationError.at(place)
    if interior.unit != "mm":
        raise wrong("distortion that varies with the distance needs c in mm", 'give unit = "mm"')
    c = interior.value("c") / MM
    distances = [keys.focus.distance_m, *(calibration.distance_m for calibration in keys.focus.calibrations)]
    if min(distances) <= c:
        raise wrong(
            f"the focus distance {min(distances):g} m is not beyond c = {c:g} m", "give distances in metres"
        )
    if not keys.focus.calibrations:
        return interior
    if len(keys.focus.calibrations) != 2 or distances[1] == distances[2]:
        raise wrong("give two calibrations, at different distances", "give distance_m and K1..")
    if any(name in RADIAL for name in keys.parameters):
        raise wrong("K1 to K4 are given in parameters and in calibrations", "remove one of them")
    near, far = (
        replace(interior.changed(**{k: getattr(focus, k) for k in RADIAL}), focus_m=focus.distance_m)
        for focus in sorted(keys.focus.calibrations, key=lambda calibration: calibration.distance_m)
    )
    return focused(near, far, keys.focus.distance_m)
