"""`block.toml`: what the tables of a block folder mean, checked key by key."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AliasChoices, Field, FiniteFloat, PositiveFloat, PositiveInt

from drivers.errors import ConfigurationError
from photocal.checked_toml import Table, read_toml
from photocal.geometry.camera import PARAMETERS, Affinity, AffinityForm, Camera, Model, camera

NonNegative = Annotated[FiniteFloat, Field(ge=0)]


# A sigma, one for each axis, or "free" for an unknown without prior knowledge.
Sigma = NonNegative | tuple[NonNegative, NonNegative, NonNegative] | Literal["free"]
BodyAxis = Literal["forward", "backward", "right", "left", "up", "down"]


class BlockKeys(Table):
    """Section `[block]`."""

    name: str = ""
    frame: str
    height: Literal["ellipsoidal", "orthometric", "local", ""] = Field(
        default="", validation_alias=AliasChoices("height", "height_kind")
    )
    datum: Literal["control", "free"] | list[str] = "control"
    datum_points: tuple[str, ...] = ()


class ObservationKeys(Table):
    """Section `[observations]`."""

    unit: Literal["px", "mm"]
    axes: Literal["pixel", "photo"]
    sigma: PositiveFloat | tuple[PositiveFloat, PositiveFloat] | None = None


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
    affinity: Affinity = "additive"
    affinity_form: AffinityForm = "fraser"


class MountingKeys(Table):
    """Section `[mounting]`: where the GNSS antenna and the inertial unit sit beside the camera."""

    lever_arm_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    lever_arm_sigma_m: Sigma = 0.0
    boresight_deg: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    boresight_sigma_deg: Sigma = 0.0
    time_offset_s: FiniteFloat = 0.0
    time_offset_sigma_s: Sigma = 0.0
    strip_shift_sigma_m: Sigma = 0.0
    strip_drift_sigma_m_s: Sigma = 0.0
    camera_axes: tuple[BodyAxis, BodyAxis, BodyAxis] = ("right", "forward", "up")


class Setup(Table):
    """The whole of `block.toml`."""

    block: BlockKeys
    observations: ObservationKeys
    camera: list[CameraKeys] = Field(min_length=1)
    mounting: MountingKeys = MountingKeys()


def read_setup(path: Path) -> Setup:
    """Read and check `block.toml`.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Setup

    Raises
    ------
    InputNotFoundError
        When there is no such file.
    ConfigurationError
        For what is not TOML, an unknown key, a missing one, or an impossible value.
    """
    return read_toml(path, Setup)


def make_camera(keys: CameraKeys, where: object) -> Camera:
    """Make the camera that a `[[camera]]` describes.

    Parameters
    ----------
    keys : CameraKeys
    where : object
        What to name in messages.

    Returns
    -------
    Camera

    Raises
    ------
    ConfigurationError
        For unknown parameters, a missing pitch or principal distance, or sigmas that do not fit.
    """
    place = f"{where}, camera {keys.id}"
    for section, names in (
        ("parameters", list(keys.parameters)),
        ("estimate", list(keys.estimate)),
        ("prior_sigma", list(keys.prior_sigma)),
    ):
        unknown = [name for name in names if name not in PARAMETERS]
        if unknown:
            raise ConfigurationError(
                f"{section} names {unknown[0]}, which is no camera parameter",
                where=place,
                remedy=f"use {', '.join(PARAMETERS)}",
            )
    if not keys.parameters.get("c", 0.0) > 0:
        raise ConfigurationError(
            "the principal distance c is missing or not positive", where=place, remedy="give c in parameters"
        )
    if keys.unit == "mm" and keys.pitch_mm is None:
        raise ConfigurationError(
            "pitch_mm is missing", where=place, remedy='give the pixel pitch, or unit = "px"'
        )
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
        raise ConfigurationError(
            f"{idle[0]} has a prior sigma but is not estimated", where=place, remedy="list it in estimate"
        )
    return camera(
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
    )
