"""`photocal plan`, `plan-network`, `flown`: photo flights and close-range networks, what a flight covered."""

from pathlib import Path
from typing import Annotated

from photocal.base.console import AsJson, Language, answer, argument, option, spread
from photocal.base.errors import InputNotFoundError
from photocal.base.progress_bars import progress
from photocal.planning.options import (
    FlightOptions,
    FlownOptions,
    LimitOptions,
    MissionOptions,
    PrecisionOptions,
)


@spread
def plan(
    area: Annotated[
        Path, argument("Polygon: GeoJSON, KML, KMZ, or CSV with lat_deg and lon_deg.", metavar="AREA")
    ],
    output: Annotated[Path, option("Folder for the plan.", "-o", "--output")],
    flight: FlightOptions,
    limits: LimitOptions,
    mission: MissionOptions,
    precision: PrecisionOptions,
    language: Language = "",
    *,
    as_json: AsJson = False,
) -> None:
    """Plan a photo flight: height, overlaps, strips, expected precision, control, mission.

    Writes `flight.plan` (QGroundControl) and `flight.waypoints` (MAVLink) with the camera triggered by
    distance, `exposures.csv`, `plan.geojson` for QGIS and `plan.json`.

    Example: `photocal plan field.kml -o plan --focal-mm 8.8 --pixel-um 2.41 --image-px 5472x3648
    --gsd-cm 3 --second-height 140 --home -28.853,-51.294,700 --ground-height 705`
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.planning.plan import plan as planned

    say = catalogue(spoken(language))
    with progress("planning and adjusting the flight", None):
        made = planned(area, flight.request(), limits=limits, mission=mission, precision=precision)
    names = made.write(output, mission)
    written = say("planned.written", place=output, names=", ".join(names))
    last = [] if made.takeoff else [say("planned.no_mission")]
    answer(as_json, made.figures, lambda: "\n".join([made.text(say), written, *last]))


def plan_network(
    network: Annotated[
        Path, argument("TOML file: camera, object, stations, datum, distances.", metavar="NETWORK.toml")
    ],
    output: Annotated[
        Path | None, option("Folder for figures, picture, block and adjustment.", "-o", "--output")
    ] = None,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Predict the precision of a close-range network before the photos are taken.

    Stations around an object or a test field, with their rolls, are adjusted without errors: sigmas of the
    targets, of the stations and of the camera follow, and the correlations of its parameters. [camera] has
    focal_mm, pixel_um, image_px, image_sigma_px, estimate; [object] field, cylinder or points (a CSV) and
    steepest_deg; [[stations]] ring or at, target, rolls_deg; [datum] control and control_sigma_m, or held
    (a photo); without both inner constraints; [[distance]] between and sigma_m. The folder `block` is what
    `photocal adjust` takes. Examples to begin with: configs/networks.

    Example: `photocal plan-network configs/networks/test-field.toml -o planned`
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.planning.network_file import plan_network as planned

    say = catalogue(spoken(language))
    with progress("adjusting the planned network", None):
        made = planned(network)
    names = () if output is None else made.write(output)
    written = [say("planned.written", place=output, names=", ".join(names))] if names else []
    answer(as_json, made.figures, lambda: "\n".join([made.text(say), *written]))


@spread
def flown(
    block: Annotated[
        Path, argument("Block folder, PROJECT.toml, or a set-up file of another program.", metavar="BLOCK")
    ],
    files: FlownOptions,
    run: Annotated[Path | None, option("Adjustment of the block; without: orientations as given.")] = None,
    exposure_ms: Annotated[float | None, option("Exposure time, ms, if the images do not state it.")] = None,
    speed: Annotated[
        float | None, option("Speed over ground, m/s, if it cannot be derived from the block.")
    ] = None,
    output: Annotated[
        Path | None, option("Folder for figures, table, map and picture.", "-o", "--output")
    ] = None,
    language: Language = "",
    as_json: Annotated[bool, option("Print the figures as JSON.", "--json")] = False,
) -> None:
    """Measure a flown block: height, ground sampling, tilt, real overlaps, rays, gaps, motion blur.

    Overlap is the share of an image that the next one (forward) or the neighbouring strip (side) shows, over
    the ground through the block's points. Laser distances of the pictures are compared with the
    surface of the tie points, or with a terrain model.

    Example: `photocal flown PROJECT.toml --images photos --plan plan/plan.json -o flown`
    """
    from math import nan

    from photocal.block.project import is_project, read_project
    from photocal.findings.texts import catalogue, spoken
    from photocal.planning.flown_output import flown_text
    from photocal.run.flown import measure_flown

    if is_project(block):
        project = read_project(block)
        block, run = project.output / "block", run or project.output / "calibration"
        if not block.exists():
            raise InputNotFoundError("has no block yet", "run `photocal run` first", where=project.path)
    exposure_s = nan if exposure_ms is None else exposure_ms / 1e3
    measured = measure_flown(block, run, files, exposure_s, nan if speed is None else speed)
    figures = {} if measured is None else measured.figures
    if output is not None and measured is not None:
        measured.write(output)
        measured.draw(output)
    answer(as_json, lambda: figures, lambda: flown_text(figures, catalogue(spoken(language))))
