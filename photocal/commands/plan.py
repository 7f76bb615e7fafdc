"""`photocal plan`, `flown`: a photo flight over a polygon, and what it covered of it."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from photocal.base.console import AsJson, answer, argument, numbers_of, option, progress
from photocal.base.errors import ConfigurationError

if TYPE_CHECKING:
    from photocal.planning.mission import Home


_SIZE = re.compile(r"^(?P<columns>[0-9]+)\s*[xX]\s*(?P<rows>[0-9]+)$")


def plan(
    area: Annotated[Path, argument("Polygon: GeoJSON, KML, or CSV with lat_deg and lon_deg.")],
    output: Annotated[Path, option("Folder for the plan.", "-o", "--output")],
    focal_mm: Annotated[float, option("Principal distance, mm.")],
    pixel_um: Annotated[float, option("Pixel pitch, micrometres.")],
    image_px: Annotated[str, option("Image size, columns x rows, such as 5472x3648.")],
    height: Annotated[float | None, option("Height above ground, m (or --gsd-cm).")] = None,
    gsd_cm: Annotated[float | None, option("Ground sample distance, cm (or --height).")] = None,
    forward: Annotated[float, option("Forward overlap, 0 to 1.")] = 0.8,
    side: Annotated[float, option("Side overlap, 0 to 1.")] = 0.7,
    width_along: Annotated[bool, option("Image width along the flight line (otherwise across it).")] = False,
    azimuth_deg: Annotated[
        float | None, option("Flying direction, degrees from north; without: fewest strips.")
    ] = None,
    cross: Annotated[bool, option("Add cross strips.", "--cross")] = False,
    second_height: Annotated[
        float | None, option("Fly the cross strips at this height above ground, m (calibration).")
    ] = None,
    speed: Annotated[
        float, option("Speed over ground, m/s; of a fixed wing in a given wind, through the air.")
    ] = 10.0,
    border: Annotated[float, option("Cover so much about the area as well, m.")] = 0.0,
    wind: Annotated[
        str | None,
        option("SPEED,FROM: m/s, and the direction it comes from, degrees: what the strips become."),
    ] = None,
    radio_range: Annotated[float | None, option("Range of the radio link, m, to check from --home.")] = None,
    scale: Annotated[str | None, option("Map scale of the product, such as 1:1000.")] = None,
    map_class: Annotated[str, option("Class that the product shall reach.", "--class")] = "A",
    standard: Annotated[str, option("Standard of that class.")] = "pec-pcd",
    exposure_ms: Annotated[float | None, option("Exposure time, ms, to check the smear.")] = None,
    shortest_interval: Annotated[
        float | None, option("Shortest time between two photos of the camera, s.")
    ] = None,
    home: Annotated[
        str | None, option("Take-off place: LAT,LON,HEIGHT above mean sea level; needed for a mission.")
    ] = None,
    ground_height: Annotated[
        float | None, option("Mean height of the area above mean sea level, m; needed for a mission.")
    ] = None,
    autopilot: Annotated[str, option("ardupilot or px4.")] = "ardupilot",
    vehicle: Annotated[str, option("quadrotor or fixed-wing.")] = "quadrotor",
    control: Annotated[int, option("Number of control points to suggest.")] = 8,
    check: Annotated[int, option("Number of check points to suggest.")] = 30,
    simulation: Annotated[bool, option("Adjust the planned flight to expect its precision.")] = True,
    image_sigma_px: Annotated[float, option("Expected precision in the image, px.")] = 0.5,
    control_sigma_m: Annotated[
        str, option("Expected precision of control in plane and height, m.")
    ] = "0.02,0.03",
    gnss_sigma_m: Annotated[
        str | None, option("Precision of exposure positions in plane and height, m.")
    ] = None,
    calibrate: Annotated[bool, option("Estimate the camera from the flight itself.", "--calibrate")] = False,
    relief_m: Annotated[float, option("Terrain above and below its mean, m.")] = 0.0,
    as_json: AsJson = False,
) -> None:
    """Plan a photo flight: height, overlaps, strips, expected precision, control, mission.

    Writes `flight.plan` (QGroundControl) and `flight.waypoints` (MAVLink) with the camera triggered by
    distance, `exposures.csv`, `plan.geojson` for QGIS and `plan.json`.

    Example: `photocal plan field.kml -o plan --focal-mm 8.8 --pixel-um 2.41 --image-px 5472x3648
    --gsd-cm 3 --second-height 140 --home -28.853,-51.294,700 --ground-height 705`
    """
    from photocal.accuracy.standard import load_standard, parse_scale
    from photocal.findings.finding import Finding
    from photocal.planning.area import read_area
    from photocal.planning.flight import Wish, plan_flight, suggest_layout
    from photocal.planning.frame import Frame, flying_height, scale_denominator
    from photocal.planning.mission import write_plan
    from photocal.planning.summary import remarks, targets_of, to_json, to_text
    from photocal.planning.wind import WIND_TEXT, at_speed, farthest_m, in_wind

    size = _SIZE.match(image_px.strip())
    if size is None:
        raise ConfigurationError(f"{image_px!r} is not an image size", "write columns x rows: 5472x3648")
    frame = Frame(focal_mm * 1e-3, pixel_um * 1e-6, int(size["columns"]), int(size["rows"]))
    if (height is None) == (gsd_cm is None):
        raise ConfigurationError("give either --height or --gsd-cm")
    if height is None:
        height = flying_height(frame.focal_m, scale_denominator((gsd_cm or 0.0) * 1e-2, frame.pixel_m))
    wish = Wish(
        frame,
        height,
        forward,
        side,
        along="columns" if width_along else "rows",
        speed_m_s=speed,
        azimuth_rad=None if azimuth_deg is None else math.radians(azimuth_deg),
        cross_strips=cross,
        second_height_m=second_height,
        border_m=border,
    )
    if (home is None) != (ground_height is None):
        raise ConfigurationError("a mission needs both --home and --ground-height")
    flight = plan_flight(read_area(area), wish)
    targets = () if scale is None else targets_of(load_standard(standard), parse_scale(scale), map_class)
    takeoff = None if home is None or ground_height is None else (_home(home), ground_height)
    if radio_range is not None and takeoff is None:
        raise ConfigurationError("--radio-range needs --home and --ground-height")
    blown, fast = None, flight
    if wind is not None:
        strength, direction = numbers_of(wind, "--wind", "SPEED,FROM: m/s and degrees, such as 6,220")
        blown = in_wind(flight, strength, math.radians(direction), vehicle)
        fast = at_speed(flight, blown["fastest_m_s"])
    notes = remarks(fast, targets, None if exposure_ms is None else exposure_ms * 1e-3, shortest_interval)
    away = None if takeoff is None else farthest_m(flight, *takeoff)
    if away is not None and radio_range is not None and away > radio_range:
        notes = (*notes, Finding("radio-range", "doubtful", figures={"far_m": away, "range_m": radio_range}))
    # Half a base keeps the points on several photos without leaving the corners.
    layout = suggest_layout(flight.corners_m, control, check, flight.levels[0].base_m / 2.0)
    figures = to_json(flight, targets, notes) | {"farthest_m": away, "wind": blown}
    simulated = ""
    if simulation:
        from photocal.planning import simulated_adjustment

        if not (image_sigma_px > 0.0 and relief_m >= 0.0):
            raise ConfigurationError("image precision must be positive and relief not negative")
        positions = None if gnss_sigma_m is None else _pair(gnss_sigma_m)
        survey = simulated_adjustment.Survey(
            image_sigma_px, _pair(control_sigma_m), positions, calibrate, relief_m
        )
        with progress("adjusting the planned flight", None):
            result = simulated_adjustment.simulate(flight, layout, survey)
        figures["simulated"] = simulated_adjustment.to_json(result, survey)
        simulated = "\n" + simulated_adjustment.to_text(result)
    names = write_plan(output, flight, layout, takeoff, autopilot, vehicle, figures)
    in_the_wind = "" if blown is None else "\n" + WIND_TEXT.format(**blown)
    if away is not None:
        in_the_wind += f"\nfarthest photo {away:.0f} m from the take-off place"
    missing = "" if takeoff else "\nno mission written: give --home LAT,LON,HEIGHT and --ground-height"
    answer(
        as_json,
        lambda: figures,
        lambda: (
            f"{to_text(flight, targets, notes)}{in_the_wind}{simulated}\n"
            f"written to {output}: {', '.join(names)}{missing}"
        ),
    )


def _pair(text: str) -> tuple[float, float]:
    plane, height = numbers_of(text, "sigma", "PLANE,HEIGHT: metres, write 0.02,0.03")
    if not (plane > 0.0 and height > 0.0):
        raise ConfigurationError(f"a precision of {text} m is not positive", "write 0.02,0.03")
    return plane, height


def _home(text: str) -> Home:
    from photocal.planning.mission import Home

    form = "LAT,LON,HEIGHT: degrees, metres above mean sea level"
    latitude, longitude, height = numbers_of(text, "--home", form)
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        raise ConfigurationError(f"{text!r} is no place on earth", "latitude comes first")
    return Home(latitude, longitude, height)


def flown(
    block: Annotated[Path, argument("Block folder, PROJECT.toml, or a set-up file of another program.")],
    run: Annotated[Path | None, option("Adjustment of the block; without: orientations as given.")] = None,
    images: Annotated[Path | None, option("Folder of the image files, for exposure time and ISO.")] = None,
    plan: Annotated[Path | None, option("plan.json of `photocal plan`, to compare with.")] = None,
    exposure_ms: Annotated[float | None, option("Exposure time where the images do not tell it, ms.")] = None,
    speed: Annotated[float | None, option("Speed over ground where the block does not tell it, m/s.")] = None,
    output: Annotated[
        Path | None, option("Folder for figures, table, map and picture.", "-o", "--output")
    ] = None,
    as_json: Annotated[bool, option("Print the figures as JSON.", "--json")] = False,
) -> None:
    """Measure a flown block: height, ground sampling, tilt, real overlaps, rays, gaps, smear.

    Overlap is the share of an image that the next one (forward) or the neighbouring strip (side) shows, over
    the ground through the block's points.

    Example: `photocal flown PROJECT.toml --images photos --plan plan/plan.json -o flown`
    """
    from math import nan

    from photocal.planning.flown_output import flown_text
    from photocal.project import read_project
    from photocal.run.flown import measure_flown

    if block.suffix == ".toml" and (block.parent / "block.toml") != block:
        project = read_project(block)
        block, run = project.output / "block", run or project.output / "calibration"
    exposure_s = nan if exposure_ms is None else exposure_ms / 1e3
    figures = measure_flown(block, run, images, plan, exposure_s, nan if speed is None else speed, output)
    answer(as_json, lambda: figures, lambda: flown_text(figures))
