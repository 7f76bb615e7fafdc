"""`block.toml`: what the tables of a block folder mean, checked key by key."""

from typing import Literal, Self

from pydantic import AliasChoices, Field, FiniteFloat, PositiveFloat, model_validator

from photocal.base.checked_toml import Table
from photocal.block.camera_setup import CameraKeys, NonNegative, Sigma
from photocal.block.model import Repetition
from photocal.block.rig import HeadKeys

BodyAxis = Literal["forward", "backward", "right", "left", "up", "down"]


class BlockKeys(Table):
    """Section `[block]`."""

    name: str = ""
    frame: str
    # Unstated: files of another program do not state the height reference.
    height: Literal["ellipsoidal", "orthometric", "local", "unstated", ""] = Field(
        default="", validation_alias=AliasChoices("height", "height_kind")
    )
    datum: Literal["control", "free"] | list[str] = "control"
    datum_points: tuple[str, ...] = ()
    global_test: Literal["two-sided", "one-sided", "none"] = "two-sided"
    level: float = Field(default=0.95, gt=0.5, lt=1.0)
    refraction: float | None = Field(default=None, ge=-2.0, le=2.0)
    curvature: bool = False

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.curvature and self.frame != "local":
            raise ValueError("a coordinate system contains the earth's curvature: leave curvature out")
        return self


class ObservationKeys(Table):
    """Section `[observations]`.

    repetition: how the readings agreed whose means stand in the table.
    """

    unit: Literal["px", "mm"]
    axes: Literal["pixel", "photo"]
    sigma: PositiveFloat | tuple[PositiveFloat, PositiveFloat] | None = None
    readings: Literal["conformal", "affine", "projective"] | None = None
    rejection_limit: PositiveFloat | None = None
    repetition: Repetition | None = None

    @model_validator(mode="after")
    def _read_once(self) -> Self:
        if self.repetition is not None and self.rejection_limit is not None:
            raise ValueError("repetition is for means of several readings: leave rejection_limit out")
        return self


class MountingKeys(Table):
    """Section `[mounting]`: where the GNSS antenna and the inertial unit sit beside the camera."""

    lever_arm_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    lever_arm_sigma_m: Sigma = 0.0
    boresight_deg: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    boresight_sigma_deg: Sigma = 0.0
    time_offset_s: FiniteFloat = 0.0
    time_offset_sigma_s: Sigma = 0.0
    flight_shift_sigma_m: Sigma = 0.0
    height_scale_sigma: NonNegative = 0.0
    height_scale_from_m: FiniteFloat | None = None
    strip_shift_sigma_m: Sigma = 0.0
    strip_drift_sigma_m_s: Sigma = 0.0
    camera_axes: tuple[BodyAxis, BodyAxis, BodyAxis] = ("right", "forward", "up")


class LaserKeys(Table):
    """Section `[laser]`: what the errors of all laser distances have in common."""

    offset_sigma_m: NonNegative | Literal["free"]
    scale_sigma: NonNegative


class Setup(Table):
    """The whole of `block.toml`."""

    block: BlockKeys
    observations: ObservationKeys
    camera: list[CameraKeys] = Field(min_length=1)
    mounting: MountingKeys = MountingKeys()
    head: tuple[HeadKeys, ...] = ()
    laser: LaserKeys | None = None
