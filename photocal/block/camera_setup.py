"""`[[camera]]`: what a block or a project says of a camera, checked key by key."""

import tomllib
from dataclasses import replace
from importlib import resources
from typing import Annotated, Literal

import numpy as np
from pydantic import AliasChoices, Field, FiniteFloat, PositiveFloat, PositiveInt

from photocal.base.arrays import Floats
from photocal.base.checked_toml import Table
from photocal.base.errors import ConfigurationError
from photocal.geometry.camera import (
    MM,
    MODELS,
    PARAMETERS,
    Affinity,
    AffinityForm,
    Camera,
    DistortionAt,
    Model,
    ReadoutDirection,
    Shutter,
    among,
    camera,
)
from photocal.geometry.distortion import focused

NonNegative = Annotated[FiniteFloat, Field(ge=0)]
# A sigma, one for each axis, or "free" for an unknown without prior knowledge.
Sigma = NonNegative | tuple[NonNegative, NonNegative, NonNegative] | Literal["free"]
RADIAL = ("K1", "K2", "K3", "K4")


def sigmas(given: Sigma) -> Floats:
    """Give the sigmas of three axes; infinite where they are free."""
    return np.broadcast_to(np.inf if given == "free" else np.asarray(given, dtype=float), 3)


class FocusCalibrationKeys(Table):
    """Radial distortion at one distance of focus; `inf` is a distance too."""

    distance_m: Annotated[float, Field(gt=0)]
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
    """One `[[camera]]`."""

    id: str
    model: Model
    unit: Literal["mm", "px"]
    size_px: tuple[PositiveInt, PositiveInt]
    pitch_mm: PositiveFloat | tuple[PositiveFloat, PositiveFloat] | None = None
    parameters: dict[str, FiniteFloat]
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


def make_camera(keys: CameraKeys, where: object) -> Camera:
    """Make the camera that a `[[camera]]` describes.

    raises ConfigurationError: for unknown parameters, a missing pitch or principal distance, or sigmas that
        do not fit.
    """
    place, lens = f"{where}, camera {keys.id}", MODELS[keys.model]
    wrong = ConfigurationError.at(place)
    for section in ("parameters", "estimate", "prior_sigma", "photo_variant"):
        unknown = [name for name in getattr(keys, section) if name not in lens.names]
        if unknown:
            raise wrong(
                f"{section} names {unknown[0]}, which is no camera parameter of {keys.model}",
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
    if keys.unit == "px":
        pitch = (1.0, 1.0)
    else:
        pitch = keys.pitch_mm if isinstance(keys.pitch_mm, tuple) else (keys.pitch_mm or 0.0,) * 2
    estimate = tuple(name for name in PARAMETERS if name in keys.estimate)
    # A prior sigma of 0 holds the parameter, as it does for coordinates.
    held = {name for name, sigma in keys.prior_sigma.items() if sigma == 0}
    weighted = {name: sigma for name, sigma in keys.prior_sigma.items() if sigma > 0}
    idle = [name for name in weighted if name not in estimate]
    if idle:
        raise wrong(f"{idle[0]} has a prior sigma but is not estimated", "list it in estimate")
    for name, deviation in keys.photo_variant.items():
        if deviation == "free" and name in estimate and not weighted.get(name):
            raise wrong(
                f"{name} is free in every image: its value for the camera is then none",
                "take it out of estimate, or give photo_variant a standard deviation",
            )
    interior = _focused(
        keys,
        place,
        camera(
            keys.id,
            keys.model,
            keys.unit,
            keys.size_px,
            pitch,
            keys.parameters,
            estimate=tuple(name for name in estimate if name not in held),
            prior_sigma=weighted,
            reference_radius=keys.R0,
            affinity=keys.affinity,
            affinity_form=keys.affinity_form,
            photo_variant={
                name: np.inf if deviation == "free" else deviation
                for name, deviation in keys.photo_variant.items()
            },
            focus_m=0.0 if keys.focus is None else keys.focus.distance_m,
        ),
    )
    interior = _with_known_readout(keys, place, interior)
    rolling = interior.rolling or "readout" in keys.parameters
    varies = "readout" in keys.photo_variant
    if varies or (rolling and keys.shutter not in (None, "rolling")):
        what = "varies from image to image" if varies else f"has a {keys.shutter} shutter"
        raise wrong(f"the readout {what}", 'give shutter = "rolling", and one readout for all images')
    if keys.shutter == "rolling" and not rolling:
        raise wrong(
            "a rolling shutter has neither a readout in parameters nor in estimate",
            'add "readout" (s) to one of them, or give shutter = "unknown" to have it tested',
        )
    return replace(
        interior,
        guessed=keys.guessed,
        distortion_at=keys.distortion_at,
        shutter="rolling" if rolling else keys.shutter or "global",
        readout_direction=keys.readout_direction,
        gust=(keys.gust.velocity_m_s, float(np.radians(keys.gust.rate_deg_s))),
    )


def _with_known_readout(keys: CameraKeys, place: str, interior: Camera) -> Camera:
    """Take the readout of a known camera; estimated, it is an observation with the table's sigma."""
    if not keys.readout_from:
        return interior
    wrong = ConfigurationError.at(place)
    if "readout" in keys.parameters:
        raise wrong("readout_from stands beside a readout in parameters", "remove one of them")
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
        raise wrong("calibrations must be two, at different distances", "give distance_m and K1..")
    if any(name in RADIAL for name in keys.parameters):
        raise wrong("K1 to K4 stand in parameters and in calibrations", "remove one of them")
    near, far = (
        replace(interior.changed(**{k: getattr(focus, k) for k in RADIAL}), focus_m=focus.distance_m)
        for focus in sorted(keys.focus.calibrations, key=lambda calibration: calibration.distance_m)
    )
    return focused(near, far, keys.focus.distance_m)
