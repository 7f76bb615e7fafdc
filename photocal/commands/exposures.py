"""`photocal exposures`: position and attitude of every exposure of a flight."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer


def exposures(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for exposures.csv and the rest.")],
    flight: Annotated[Path | None, typer.Argument(help="Flight log.")] = None,
    images: Annotated[Path | None, typer.Option(help="Folder of the images.")] = None,
    mrk: Annotated[Path | None, typer.Option(help="The vehicle's own event list (Timestamp.MRK).")] = None,
    edge: Annotated[str, typer.Option(help="Edge of the time marks: rising or falling.")] = "rising",
    delay: Annotated[float, typer.Option(help="From the event to the exposure, seconds.")] = 0.0,
    lever_arm: Annotated[
        str | None,
        typer.Option(help="X,Y,Z from the antenna to the camera, metres forward, right, down."),
    ] = None,
    lever_arm_sigma: Annotated[str | None, typer.Option(help="Its standard deviations, metres.")] = None,
    attitude_sigma: Annotated[
        str | None, typer.Option(help="Standard deviations of roll, pitch, yaw, degrees.")
    ] = None,
    clock_offset: Annotated[
        float, typer.Option(help="Largest offset between the camera's clock and the log's, seconds.")
    ] = 60.0,
    camera: Annotated[str, typer.Option(help="Id of the camera in images.csv.")] = "camera",
    crs: Annotated[
        str | None, typer.Option(help="System of images.csv, such as EPSG:32722; without: local.")
    ] = None,
    rover: Annotated[Path | None, typer.Option(help="RINEX observations of the rover.")] = None,
    base: Annotated[Path | None, typer.Option(help="RINEX observations of the base.")] = None,
    nav: Annotated[list[str] | None, typer.Option(help="RINEX navigation file; may be repeated.")] = None,
    base_position: Annotated[
        str | None, typer.Option(help="LAT,LON,H of the base: degrees, ellipsoidal height in metres.")
    ] = None,
    rover_link: Annotated[str, typer.Option(help="Link of the rover in the flight log.")] = "rover",
    base_link: Annotated[str, typer.Option(help="Link of the base in the flight log.")] = "base",
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Compute position, attitude and covariance of every exposure.

    Positions come from PPK where the log has raw frames of rover and base, else from the event list or the
    autopilot; images are matched to events by the differences of their times.

    Example: `photocal exposures FLIGHT.mcap --images DIR -o exposures`
    """
    import json
    import tempfile

    import numpy as np

    from acquire.outputs import output_folder
    from drivers.errors import ConfigurationError
    from photocal.navigation.engine import Rtklib
    from photocal.navigation.exposure_files import write_block_images, write_exposures, write_geo_txt
    from photocal.navigation.exposure_plot import plot_exposures
    from photocal.navigation.exposure_run import ELLIPSOIDAL, Choices, exposures_text, run_exposures
    from photocal.navigation.ppk_inputs import Sources
    from photocal.navigation.triple import parse_triple

    if edge not in ("rising", "falling"):
        raise ConfigurationError(f"{edge!r} is no edge", where="--edge", remedy="rising or falling")
    angle_sigma = parse_triple(attitude_sigma, "--attitude-sigma")
    choices = Choices(
        Sources(flight, rover, base, tuple(nav or ()), base_position, rover_link, base_link),
        images,
        mrk,
        edge,
        delay,
        parse_triple(lever_arm, "--lever-arm"),
        parse_triple(lever_arm_sigma, "--lever-arm-sigma"),
        None if angle_sigma is None else np.radians(angle_sigma),
        clock_offset,
    )
    with tempfile.TemporaryDirectory() as scratch:
        run = run_exposures(choices, Rtklib(), Path(scratch))
    figures = run.figures
    with output_folder(output) as folder:
        write_exposures(folder / "exposures.csv", run.exposures)
        if images is not None:
            if crs is not None and run.exposures.height_kind != ELLIPSOIDAL:
                raise ConfigurationError(
                    f"heights are {run.exposures.height_kind}: they cannot be taken to {crs}",
                    where="--crs",
                    remedy="leave out --crs",
                )
            figures["images_csv"] = write_block_images(
                folder / "images.csv", run.exposures, camera, choices.angle_sigma, crs
            )
            write_geo_txt(folder / "geo.txt", run.exposures)
        (folder / "exposures.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
        plot_exposures(run, folder / "exposures.png")
    answer(as_json, lambda: figures, lambda: exposures_text(figures))
