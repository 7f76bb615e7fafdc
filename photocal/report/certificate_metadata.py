"""What a certificate says that no adjustment knows: given by a person, in a TOML file, all of it optional."""

import datetime as dt
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, FiniteFloat, PositiveFloat

from photocal.base.checked_toml import Table, checked_tables, read_tables
from photocal.base.errors import ConfigurationError
from photocal.base.policy import policy

Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Sigmas = tuple[PositiveFloat, PositiveFloat, PositiveFloat]
Vertex = tuple[str, FiniteFloat, FiniteFloat]
# What may add to the uncertainty of c beside the adjustment.
Source = Literal["control", "datum", "temperature", "refocus", "model"]
# What `photocal radiometry` measures.
Radiometry = Literal[
    "edge_slant_deg", "mtf50_cycles_px", "mtf10_cycles_px", "mtf_at_nyquist", "star_limit_cycles_px",
    "ground_resolution_cm", "corner_brightness", "linearity_error", "linearity_r2",
]  # fmt: skip
# What `photocal flown` counts.
FlownCount = Literal["images", "strips", "tilt_over_3_deg", "tilt_over_5_deg", "smear_over_limit", "gaps"]


# A form of an authority that the certificate fills in, too: "br-md" is the technical report of the Brazilian
# Ministry of Defence.
Form = Literal["", "br-md"]


class DocumentKeys(Table):
    """Section `[document]`."""

    client: str = ""
    operator: str = ""
    place: str = ""
    comments: str = ""
    references: tuple[str, ...] = ()
    form: Form = ""


class CameraParticulars(Table):
    """Section `[camera]`: what the maker says."""

    model: str = ""
    manufacturer: str = ""
    serial: str = ""
    lens_type: str = ""
    lens_serial: str = ""
    sensor_type: str = ""
    sensor_size_mm: Annotated[tuple[PositiveFloat, ...], Field(min_length=1, max_length=2)] | None = None
    effective_pixels: PositiveFloat | None = None
    nominal_focal_length_mm: PositiveFloat | None = None
    pixel_size_mm: PositiveFloat | None = None


class GnssInsKeys(Table):
    """Section `[gnss_ins]`: positioning system and its offsets."""

    receiver: str = ""
    description: str = ""
    lever_arm_cm: Triple | None = None
    lever_arm_sigma_cm: Sigmas | None = None
    boresight_deg: Triple | None = None
    boresight_sigma_deg: Sigmas | None = None
    boresight_prior_sigma_deg: PositiveFloat | None = None


class CampaignKeys(Table):
    """Section `[campaign]`: field and flight."""

    method: str = ""
    test_field: str = ""
    vertices: tuple[Vertex, ...] = ()
    platform: str = ""
    flying_height_m: PositiveFloat | None = None
    gsd_cm: PositiveFloat | None = None
    iso: PositiveFloat | None = None
    exposure_time_s: PositiveFloat | None = None
    air_base_m: PositiveFloat | None = None
    forward_overlap: Annotated[float, Field(gt=0, lt=1)] | None = None


class ExteriorKeys(Table):
    """Section `[exterior_orientation]`: original less calibrated."""

    rmse_m: Triple | None = None
    mean_m: Triple | None = None
    rmse_arcsec: Triple | None = None
    mean_arcsec: Triple | None = None


class EquipmentKeys(Table):
    """One `[[equipment]]`."""

    name: str
    manufacturer: str = ""
    serial: str = ""
    use: str = ""
    calibration: str = ""


class ValidityKeys(Table):
    """Section `[validity]`."""

    until: dt.date | None = None
    conditions: str = ""


class LaboratoryKeys(Table):
    """Section `[laboratory]`: what ISO/IEC 17025 asks of a certificate."""

    name: str = ""
    address: str = ""
    place_of_work: str = ""
    client_contact: str = ""
    received: dt.date | None = None
    measured: dt.date | None = None
    traceability: str = ""
    decision_rule: str = ""
    deviations: str = ""
    external: str = ""


class ConditionKeys(Table):
    """Section `[conditions]`: under which the camera was calibrated."""

    temperature_c: FiniteFloat | None = None
    camera_temperature_c: FiniteFloat | None = None
    relative_humidity_percent: Annotated[float, Field(ge=0, le=100)] | None = None
    pressure_hpa: Annotated[float, Field(ge=400, le=1100)] | None = None
    focus: str = ""
    aperture: str = ""
    stabilisation: str = ""
    firmware: str = ""
    in_camera_correction: str = ""
    exposure: str = ""
    shutter: str = ""
    sensor_temperature: str = ""
    lens_temperature: str = ""
    positions: str = ""
    state: str = ""


class UncertaintyKeys(Table):
    """Section `[uncertainty]`: standard uncertainties of c by source, in the unit of the camera.

    common_height_m: standard uncertainty of the height that all GNSS positions share (base, antenna, geoid).
    """

    of_c: dict[Source, PositiveFloat] = Field(default_factory=dict)
    common_height_m: PositiveFloat = policy.common_height_m


class ResponsibleKeys(Table):
    """Section `[responsible]`."""

    name: str = ""
    title: str = ""
    registration: str = ""
    key: str = ""


class Metadata(Table):
    """All that a person gives; sections as in the file, the day of the certificate, and the flown block."""

    date: dt.date
    document: DocumentKeys = DocumentKeys()
    camera: CameraParticulars = CameraParticulars()
    gnss_ins: GnssInsKeys = GnssInsKeys()
    campaign: CampaignKeys = CampaignKeys()
    exterior_orientation: ExteriorKeys = ExteriorKeys()
    equipment: tuple[EquipmentKeys, ...] = ()
    validity: ValidityKeys = ValidityKeys()
    responsible: ResponsibleKeys = ResponsibleKeys()
    laboratory: LaboratoryKeys = LaboratoryKeys()
    conditions: ConditionKeys = ConditionKeys()
    radiometry: dict[Radiometry, FiniteFloat] = Field(default_factory=dict)
    uncertainty: UncertaintyKeys = UncertaintyKeys()
    flown_spread: dict[str, Triple] = Field(default_factory=dict)
    flown: dict[FlownCount, FiniteFloat] = Field(default_factory=dict)
    planned: dict[str, FiniteFloat] = Field(default_factory=dict)


def read_particulars(
    path: Path | None,
    date: dt.date,
    *,
    client: str = "",
    operator: str = "",
    form: str = "",
    key: str = "",
    pictures: Mapping[str, Mapping[str, str | float]] | None = None,
    flown: Mapping[str, Any] | None = None,
) -> Metadata:
    """Read the particulars of a certificate; what nobody typed may stand in the pictures.

    path: TOML file with what a person gives.
    form: that the certificate fills in, too; see `Form`.
    key: fingerprint of the key by which it will be signed; printed.
    pictures: what they say of camera and conditions, by section and key of the particulars.
    flown: figures of the flown block, see `planning.flown.figures_of`.
    """
    keys: dict[str, Any] = read_tables(path) if path is not None else {}
    if given := sorted(keys.keys() & {"flown", "flown_spread", "planned"}):
        raise ConfigurationError(f"{given[0]} is measured, not given", "remove it", where=path)
    keys |= _of_flown(flown) if flown else {}
    for section, stated in (pictures or {}).items():
        typed = keys.get(section, {})
        if isinstance(typed, dict):
            keys[section] = {**stated, **typed}
    if "date" in keys:
        raise ConfigurationError("unknown key 'date'", "give the day by --date", where=path)
    named = {"client": client, "operator": operator, "form": form}
    document = keys.get("document", {})
    if isinstance(document, dict):
        keys["document"] = {**document, **{key: value for key, value in named.items() if value}}
    responsible = keys.get("responsible", {})
    if isinstance(responsible, dict) and key:
        keys["responsible"] = {"key": key, **responsible}
    return checked_tables({**keys, "date": date}, Metadata, path)


def _of_flown(figures: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Take what a certificate repeats of the figures of a flown block."""
    spreads = ((name, value) for name, value in figures.items() if isinstance(value, dict))
    keys = ("least", "median", "most")
    flown_spread = {name: tuple(s[key] for key in keys) for name, s in spreads if "median" in s}
    counts = {name: figures[name] for name in get_args(FlownCount)} | {"gaps": len(figures["gaps"])}
    return {"flown_spread": flown_spread, "flown": counts, "planned": figures.get("planned", {})}


def given_particulars(keys: dict[str, Any], date: str) -> Metadata:
    """Take the particulars from a machine-readable certificate."""
    return checked_tables({**keys, "date": date}, Metadata, "certificate.json, particulars")
