"""The two folders of a simulated flight: what a surveyor brings home, and the truth."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from acquire.simulate.world import block_folder
from acquire.simulate.world.configuration import FlightConfiguration, Level
from acquire.simulate.world.observations import kept_images, observe
from acquire.simulate.world.streams import RecordedWire, make_streams, telemetry_log
from acquire.simulate.world.truth import conditions, write_truth
from acquire.simulate.world.world import World, make_world, picture_stamps

Advance = Callable[[float], None]


def write_project(world: World, site: Path) -> None:
    """Write `project.toml`, and but for the level block `control.csv`."""
    given = world.configuration
    block = given.level is Level.BLOCK
    crs, height = ("local", "local") if block else (given.place.crs, "ellipsoidal")
    head = {"name": given.name, "crs": crs, "height": height, "output": "work"}
    sections: list[tuple[str, dict[str, Any]]] = [("[project]", head)]
    if block:
        sections.append(("[measurements]", {"block": "block"}))
    else:
        notes = block_folder.take_notes(world, world.place.to_projected(world.targets.surveyed_m))
        block_folder.write_targets(world, notes, site / "control.csv", world.targets.names)
        sections += _flight(world, notes)
    judgement = given.judgement.model_dump(exclude_defaults=True)
    sections += [("[judgement]", judgement)] if judgement else []
    sections.append(("[certificate]", {"particulars": "particulars.toml"}))
    (site / "project.toml").write_text(block_folder.toml_text(sections), encoding="utf-8")


def _flight(world: World, notes: block_folder.FieldBook) -> list[tuple[str, dict[str, Any]]]:
    given = world.configuration
    base = world.place.to_geodetic(notes.base_m[None])[0]
    place = [*(round(angle, 10) for angle in np.degrees(base[:2]).tolist()), round(float(base[2]), 4)]
    # What thermometer and hygrometer show at the base.
    weather = {
        "temperature_c": round(given.air.temperature_c - 6.5e-3 * float(base[2]), 1),
        "relative_humidity_percent": round(100 * given.air.relative_humidity, 1),
    }
    pictures = given.level is Level.PICTURES
    control: dict[str, Any] = {"points": "control.csv"}
    if pictures:
        codes = zip(world.targets.codes.tolist(), world.targets.names, strict=True)
        control["targets"] = {
            "dictionary": given.targets.dictionary,
            "side_m": given.targets.side_m,
            "names": {str(code): name for code, name in codes},
        }
    sections: list[tuple[str, dict[str, Any]]] = [
        (
            "[flight]",
            {
                "logs": ["flight.mcap"],
                "vehicle": "vehicle",
                "rover": "rover",
                "base": "base",
                "base_position": place,
                "base_antenna_height_m": round(notes.base_antenna_height_m, 4),
                "rover_antenna_height_m": 0.0,
                "weather": weather,
                "edge": "rising",
                "clock_offset_s": 30.0,
            },
        ),
        ("[images]", {"folder": "images"} if pictures else {"times": "times.csv"}),
        (
            "[rig]",
            {
                **given.rig.model_dump(exclude={"position_sigma_m"}),
                "camera_to_antenna_m": notes.camera_to_antenna_m,
                "camera_axes": ["right", "forward", "up"],
            },
        ),
        ("[[camera]]", block_folder.camera_keys(given)),
        ("[control]", control),
    ]
    if not pictures:
        measured = {"observations": "observations.csv", "sigma_px": given.observing.sigma_px}
        sections.append(("[measurements]", measured))
    return sections


def write_particulars(world: World, path: Path) -> None:
    """Write what a person gives for a certificate; it says that the flight never took place."""
    given, camera = world.configuration, world.configuration.camera
    plan = given.plan
    sensor = [round(side * camera.pitch_mm, 3) for side in camera.size_px]
    text = block_folder.toml_text(
        [
            (
                "[document]",
                {
                    "client": "SIMULATED FLIGHT, it never took place",
                    "operator": "simulator",
                    "comments": f"Simulated flight {given.name!r}, seed {given.seed}.",
                },
            ),
            (
                "[camera]",
                {
                    "model": camera.id,
                    "manufacturer": "simulated",
                    "serial": f"{given.seed:04d}",
                    "lens_type": f"fixed, {camera.nominal_mm:g} mm",
                    "sensor_size_mm": sensor,
                    "effective_pixels": float(camera.size_px[0] * camera.size_px[1]),
                    "nominal_focal_length_mm": camera.nominal_mm,
                    "pixel_size_mm": camera.pitch_mm,
                },
            ),
            (
                "[campaign]",
                {
                    "method": "on-the-job calibration",
                    "test_field": given.name,
                    "platform": "multirotor, simulated",
                    "flying_height_m": plan.passes[0].height_m,
                    "exposure_time_s": camera.exposure_s,
                    "forward_overlap": plan.passes[0].forward_overlap,
                },
            ),
        ]
    )
    path.write_text(text, encoding="utf-8")


def simulate_flight(configuration: FlightConfiguration, folder: Path, advance: Advance) -> dict[str, Any]:
    """Simulate a flight and write `site/` and `truth/`."""
    world = make_world(configuration)
    site, truth = folder / "site", folder / "truth"
    site.mkdir(parents=True)
    if configuration.level is Level.CARD:
        write_card(world, site, advance)
        write_truth(world, truth, None, projected=True)
        return summary(world)
    observed = None if configuration.level is Level.PICTURES else observe(world)
    if observed is not None and configuration.level is Level.BLOCK:
        block_folder.write_block(world, observed, site / "block")
    elif observed is not None:
        block_folder.write_observations(world, observed, site / "observations.csv")
        write_times(world, site / "times.csv")
    if configuration.level is Level.PICTURES:
        from acquire.simulate.world.picture_file import write_pictures

        write_pictures(world, site / "images", advance)
    if configuration.level is not Level.BLOCK:
        write_streams(world, make_streams(world), folder)
    write_project(world, site)
    write_particulars(world, site / "particulars.toml")
    write_truth(world, truth, observed, projected=configuration.level is not Level.BLOCK)
    return summary(world)


def write_card(world: World, site: Path, advance: Advance) -> None:
    """Write pictures, surveyed points and the marks that a person made of them."""
    from acquire.simulate.world.picture_file import write_pictures

    write_pictures(world, site / "images", advance)
    notes = block_folder.take_notes(world, world.place.to_projected(world.targets.surveyed_m))
    block_folder.write_targets(world, notes, site / "control.csv", world.targets.names)
    observed = observe(world)
    marked = observed.point < len(world.targets.names)
    rows = {name: getattr(observed, name)[marked] for name in ("image", "point", "pixels", "sigma_px")}
    block_folder.write_observations(world, replace(observed, **rows), site / "marks.csv")


def write_streams(world: World, streams: dict[str, RecordedWire], folder: Path) -> None:
    """Write the recorded streams to the site, and when each frame arrived beside the truth."""
    site, wires = folder / "site", folder / "truth" / "wires"
    wires.mkdir(parents=True)
    (site / "vehicle.tlog").write_bytes(telemetry_log(world, streams["vehicle"]))
    (site / "rover.ubx").write_bytes(streams["rover"].data)
    (site / f"base.{world.configuration.gnss.base_protocol}").write_bytes(streams["base"].data)
    for name, wire in streams.items():
        sizes = [len(frame) for frame in wire.frames]
        block_folder.write_table(
            wires / f"{name}.csv", {"arrival_s": (".6f", wire.arrival_s), "bytes": ("d", sizes)}
        )


def write_times(world: World, path: Path) -> None:
    """Write `times.csv`: the names of pictures and what the camera's clock said."""
    pairs = zip(world.exposures.names, picture_stamps(world), kept_images(world).tolist(), strict=True)
    rows = [(name, stamp.isoformat(timespec="milliseconds")) for name, stamp, kept in pairs if kept]
    names, taken = zip(*rows, strict=True)
    block_folder.write_table(path, {"image": ("", names), "taken": ("", taken)})


def summary(world: World) -> dict[str, Any]:
    """Give what a flight consists of."""
    roles = world.targets.roles
    return {
        **conditions(world.configuration),
        "images": len(world.exposures),
        "control": roles.count("control"),
        "check": roles.count("check"),
        "duration_s": round(world.motion.duration_s, 1),
    }
