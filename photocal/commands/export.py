"""`photocal export`: an adjusted block for other programs."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from photocal.base.console import Language, answer, argument, numbers_of, option
from photocal.base.errors import ConfigurationError
from photocal.exchange.formats import exported

if TYPE_CHECKING:
    from photocal.exchange.exporting import Angle
    from photocal.findings.texts import Catalogue

FORMATS = ", ".join(exported())


def export(
    run: Annotated[Path, argument("Run folder that photocal adjust wrote.", metavar="RUN")],
    output: Annotated[Path, option("Folder for the files.", "-o", "--output")],
    form: Annotated[str, option(f"One of {FORMATS}; or of another package.", "--format")],
    angle_unit: Annotated[
        str, option("Unit of omega, phi, kappa for patb: deg or gon.", "--angle-unit")
    ] = "",
    origin: Annotated[
        str, option("LATITUDE,LONGITUDE,HEIGHT of the local frame (geojson, kml, geopackage).", "--origin")
    ] = "",
    language: Language = "",
    as_json: Annotated[bool, option("Print what was written as JSON.", "--json")] = False,
) -> None:
    """Export cameras, orientations, points and measurements; report the cost of a changed camera model.

    Example: `photocal export run --format colmap -o colmap`
    """
    from photocal.base.files import output_folder
    from photocal.base.geodesy import GeodeticPlace
    from photocal.block.results.adjusted_block import adjusted_block
    from photocal.block.results.folder import read_result
    from photocal.exchange.exporting import Choices, middle
    from photocal.exchange.formats import named
    from photocal.findings.texts import catalogue, spoken

    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.000Z")
    if angle_unit not in ("", "deg", "gon"):
        raise ConfigurationError(f"angle unit {angle_unit!r} is not known", "use deg or gon")
    touching = None
    if origin:
        touching = GeodeticPlace(
            *numbers_of(origin, "--origin", "LATITUDE,LONGITUDE,HEIGHT: degrees, metres")
        )
    chosen = named(form)
    adjusted = read_result(run)
    given, residuals_px = adjusted_block(adjusted)
    choices = Choices(cast("Angle", angle_unit) if angle_unit else None, touching, now, residuals_px)
    with output_folder(output) as aside:
        conversions = chosen.write(aside, given, choices)
        files = sorted(str(path.relative_to(aside)) for path in aside.rglob("*") if path.is_file())
    cartesian = chosen.space == "cartesian"
    place = None
    if cartesian and given.frame != "local":
        # Where the frame of the written files has its origin.
        axes = dict(zip("xyz", middle(given).tolist(), strict=True))
        place = {"frame": given.frame, "height": given.height, **axes}
    result = {
        "schema": "photocal.export/1",
        "format": form,
        "frame": "local" if cartesian else given.frame,
        "origin": place,
        "distortion": chosen.distortion,
        "files": files,
        "cameras": [
            {"camera": made.camera.id, "rms_px": made.rms_px, "largest_px": made.largest_px}
            for made in conversions
        ],
        "rolling_shutters": {
            name: camera.value("readout") for name, camera in adjusted.cameras.items() if camera.rolling
        },
    }
    answer(as_json, lambda: result, lambda: _text(result, output, catalogue(spoken(language))))


def _text(result: dict[str, Any], output: Path, say: "Catalogue") -> str:
    files = ", ".join(result["files"])
    lines = [say("exported.written", form=result["format"], files=files, place=output)]
    if result["origin"]:
        place = {key: result["origin"][key] for key in ("x", "y", "z", "frame")}
        lines.append(say.told("exported.origin", **place, height=say.stored(result["origin"]["height"])))
    for camera in result["cameras"]:
        how = say("exported.no_distortion" if result["distortion"] == "none" else "exported.fitted")
        sizes = {"rms": camera["rms_px"], "largest": camera["largest_px"]}
        cost = say.told("exported.cost", how=how, **sizes) if sizes["largest"] else say("exported.same")
        lines.append(say("exported.camera", camera=camera["camera"], cost=cost))
    lines += [
        say.told("exported.rolls", camera=name, readout=1e3 * readout)
        for name, readout in result["rolling_shutters"].items()
    ]
    return "\n".join(lines)
