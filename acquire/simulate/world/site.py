"""The two folders of a simulated flight: what a surveyor brings home, and the truth.

The truth of a simulated flight, written aside: nothing that is processed refers to it.

Pictures as files: JPEG with what the camera writes into EXIF, and XMP of the gimbal where there is one.
"""

import datetime as dt
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from acquire.simulate.world import block_folder
from acquire.simulate.world.block_folder import Columns, columns_of, noted_control, write_table
from acquire.simulate.world.camera import OPENCV, TrueCamera
from acquire.simulate.world.configuration import FlightConfiguration
from acquire.simulate.world.exposures import antenna_at, omega_phi_kappa
from acquire.simulate.world.observations import MeasuredPoints, kept_images, observe
from acquire.simulate.world.place import Place
from acquire.simulate.world.render import make_scene, render
from acquire.simulate.world.streams import RecordedWire, make_streams, telemetry_log
from acquire.simulate.world.telemetry import LABEL, make_filter
from acquire.simulate.world.world import World, make_world, picture_stamps
from photocal.base.arrays import Floats, picked
from photocal.base.codec import toml_text
from photocal.base.files import write_json


def write_truth(world: World, folder: Path, observed: MeasuredPoints | None, projected: bool) -> None:
    """Write `truth.json`, `flight.toml`, `exposures.csv`, `points.csv` and `trajectory.csv`."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "truth.json", _figures(world), 2)
    (folder / "flight.toml").write_text(_settings(world), encoding="utf-8")
    _write_exposures(world, folder / "exposures.csv", projected)
    _write_points(world, folder / "points.csv", observed, projected)
    _write_trajectory(world, folder / "trajectory.csv")


def _figures(world: World) -> dict[str, object]:
    rig, place = world.rig, world.place
    base = place.to_geodetic(world.base_m[None])[0]
    cameras = {
        str(int(k)): _camera(world.exposures.cameras[int(np.argmax(world.exposures.covers == k))])
        for k in np.unique(world.exposures.covers)
    }
    return {
        "schema": "acquire.simulate.truth/1",
        **conditions(world.configuration),
        "mistyped_control": noted_control(world, world.targets.surveyed_m)[1],
        "missing_images": np.array(world.exposures.names)[~kept_images(world)].tolist(),
        "camera": {
            "id": world.configuration.camera.id,
            "model": "brown-ideal",
            "affinity": "after",
            "size_px": [world.camera.width, world.camera.height],
            "pitch_mm": world.camera.pitch_mm,
            **_camera(world.camera),
            "by_pass": cameras,
        },
        "rig": {
            "camera_to_antenna_m": rig.camera_to_antenna_m.tolist(),
            "boresight_deg": np.degrees(rig.boresight).tolist(),
            "boresight_is": "rotation vector in camera axes (x right, y up, z backwards), body to camera",
            "time_offset_s": rig.time_offset_s,
            "time_offset_is": "middle of the exposure minus event",
            "readout_s": world.configuration.camera.readout_s,
        },
        "base": {
            "latitude_deg": float(np.degrees(base[0])),
            "longitude_deg": float(np.degrees(base[1])),
            "height_m": float(base[2]),
            "antenna_height_m": world.configuration.gnss.base_antenna_height_m,
        },
        "local_frame": {
            "axes": "east, north, up, topocentric at the origin on GRS 80",
            **picked(place, "latitude_deg", "longitude_deg", "height_m"),
        },
        "crs": place.crs,
        "start_gps_ns": world.start_gps_ns,
        "duration_s": world.motion.duration_s,
    }


def conditions(given: FlightConfiguration) -> dict[str, object]:
    """Give what names a flight."""
    named = {"name": given.name, "seed": given.seed, "level": given.level}
    return {**named, "faults": sorted(given.faults)}


def _settings(world: World) -> str:
    """Give the configuration with everything that was not written into it, so that it can be flown again."""
    content = world.configuration.model_dump(by_alias=True, mode="json", exclude_none=True)
    content["faults"] = sorted(content["faults"])
    # What belongs to no table stands before all tables.
    return toml_text(dict(sorted(content.items(), key=lambda item: isinstance(item[1], dict))))


def _camera(camera: TrueCamera) -> dict[str, object]:
    return {
        "px": camera.certificate_terms("px"),
        "mm": camera.certificate_terms("mm"),
        "opencv": {name: float(getattr(camera, name)) for name in OPENCV},
    }


def _write_exposures(world: World, path: Path, projected: bool) -> None:
    exposures = world.exposures
    pose = exposures.pose
    angles = np.degrees(omega_phi_kappa(pose.rotation))
    antenna = antenna_at(world.motion, world.rig, exposures.event_s)
    columns: Columns = {
        "image": ("", exposures.names),
        "pass": ("d", exposures.covers),
        "strip": ("d", exposures.strip),
        "event_gps_ns": ("d", world.gps_ns(exposures.event_s)),
        "middle_gps_ns": ("d", world.gps_ns(exposures.middle_s)),
        **columns_of("X Y Z", pose.centre_m, ".5f"),
        **columns_of("omega phi kappa", angles, ".7f"),
        **columns_of("roll pitch yaw", np.degrees(world.motion.angles(exposures.event_s)), ".6f"),
        **columns_of("antenna_X antenna_Y antenna_Z", antenna, ".5f"),
    }
    if projected:
        grid = np.degrees(omega_phi_kappa(pose.rotation @ grid_to_local(world.place, pose.centre_m)))
        columns |= columns_of("E N h", world.place.to_projected(pose.centre_m), ".5f")
        columns |= columns_of("omega_grid phi_grid kappa_grid", grid, ".7f")
        columns |= columns_of("antenna_E antenna_N antenna_h", world.place.to_projected(antenna), ".5f")
    write_table(path, columns)


def grid_to_local(place: Place, local_m: Floats) -> Floats:
    """Give rotations from grid east, grid north, up at places to the local frame, shape (n, 3, 3)."""
    # To the north and to the south: the direction of the local north in the grid.
    step_m = 10.0
    geodetic = place.to_geodetic(local_m)
    (sb, sl), (cb, cl) = np.sin(geodetic[:, :2]).T, np.cos(geodetic[:, :2]).T
    up = np.column_stack([cb * cl, cb * sl, sb]) @ place.axes.T
    ahead, behind = (
        place.to_projected(local_m + np.array([0.0, side * step_m, 0.0])) for side in (1.0, -1.0)
    )
    step = ahead - behind
    # The north of the local frame lies this much east of grid north.
    turn = np.arctan2(step[:, 0], step[:, 1])
    local_north = np.array([0.0, 1.0, 0.0]) - up * up[:, 1:2]
    local_north /= np.linalg.norm(local_north, axis=1)[:, None]
    local_east = np.cross(local_north, up)
    north = np.cos(turn)[:, None] * local_north - np.sin(turn)[:, None] * local_east
    return np.stack([np.cross(north, up), north, up], axis=2)


def _write_points(world: World, path: Path, observed: MeasuredPoints | None, projected: bool) -> None:
    targets = world.targets
    names, points = list(targets.names), targets.centre_m
    roles = list(targets.roles)
    if observed is not None:
        names, points = list(observed.names), observed.points_m
        roles += ["tie"] * (len(names) - len(roles))
    columns: Columns = {"point": ("", names), "role": ("", roles), **columns_of("X Y Z", points, ".5f")}
    if projected:
        columns |= columns_of("E N h", world.place.to_projected(points), ".5f")
    write_table(path, columns)


def _write_trajectory(world: World, path: Path) -> None:
    time = np.arange(0.0, world.motion.duration_s, world.configuration.gnss.rover_interval_s)
    antenna = antenna_at(world.motion, world.rig, time)
    geodetic = world.place.to_geodetic(antenna)
    write_table(
        path,
        {
            "time_gps_ns": ("d", world.gps_ns(time)),
            "lat_deg": (".10f", np.degrees(geodetic[:, 0])),
            "lon_deg": (".10f", np.degrees(geodetic[:, 1])),
            "height_m": (".5f", geodetic[:, 2]),
            **columns_of("roll pitch yaw", np.degrees(world.motion.angles(time)), ".6f"),
        },
    )


Advance = Callable[[float], None]


def write_project(world: World, site: Path) -> None:
    """Write `project.toml`, and but for the level block `control.csv`."""
    given = world.configuration
    block = given.level == "block"
    crs, height = ("local", "local") if block else (given.place.crs, "ellipsoidal")
    head = {"name": given.name, "crs": crs, "height": height, "output": "work"}
    sections: dict[str, Any] = {"project": head}
    if block:
        sections["measurements"] = {"block": "block"}
    else:
        write_control(world, site)
        sections |= _flight(world)
    if judgement := given.judgement.model_dump(exclude_defaults=True):
        sections["judgement"] = judgement
    sections["certificate"] = {"particulars": "particulars.toml"}
    (site / "project.toml").write_text(toml_text(sections), encoding="utf-8")


def write_control(world: World, site: Path) -> None:
    """Write `control.csv`: the targets in the projected system, as they were surveyed."""
    surveyed = world.place.to_projected(world.targets.surveyed_m)
    block_folder.write_targets(world, surveyed, site / "control.csv", world.targets.names)


def _flight(world: World) -> dict[str, Any]:
    given = world.configuration
    base = world.place.to_geodetic(world.noted_base_m[None])[0]
    place = [*(round(angle, 10) for angle in np.degrees(base[:2]).tolist()), round(float(base[2]), 4)]
    # What thermometer and hygrometer show at the base.
    weather = {
        "temperature_c": round(given.air.temperature_c - 6.5e-3 * float(base[2]), 1),
        "relative_humidity_percent": round(100 * given.air.relative_humidity, 1),
    }
    pictures = given.level == "pictures"
    control: dict[str, Any] = {"points": "control.csv"}
    if pictures:
        codes = zip(world.targets.codes.tolist(), world.targets.names, strict=True)
        control["targets"] = {
            "dictionary": given.targets.dictionary,
            "side_m": given.targets.side_m,
            "names": {str(code): name for code, name in codes},
        }
    sections = {
        "flight": {
            "logs": ["flight.mcap"],
            "vehicle": "vehicle",
            "rover": "rover",
            "base": "base",
            "base_position": place,
            "base_antenna_height_m": round(world.noted_antenna_height_m, 4),
            "rover_antenna_height_m": 0.0,
            "weather": weather,
            "edge": "rising",
            "clock_offset_s": 30.0,
        },
        "images": {"folder": "images"} if pictures else {"times": "times.csv"},
        "rig": {
            **given.rig.model_dump(exclude={"position_sigma_m"}),
            "camera_to_antenna_m": world.noted_arm_m.tolist(),
            "camera_axes": ["right", "forward", "up"],
        },
        "camera": [block_folder.camera_keys(given)],
        "control": control,
    }
    if not pictures:
        measured = {"observations": "observations.csv", "sigma_px": given.observing.sigma_px}
        sections["measurements"] = measured
    return sections


def write_particulars(world: World, path: Path) -> None:
    """Write what a person gives for a certificate; it says that the flight never took place."""
    given, camera = world.configuration, world.configuration.camera
    plan = given.plan
    sensor = [round(side * camera.pitch_mm, 3) for side in camera.size_px]
    text = toml_text(
        {
            "document": {
                "client": "SIMULATED FLIGHT, it never took place",
                "operator": "simulator",
                "comments": f"Simulated flight {given.name!r}, seed {given.seed}.",
            },
            "camera": {
                "model": camera.id,
                "manufacturer": "simulated",
                "serial": f"{given.seed:04d}",
                "lens_type": f"fixed, {camera.nominal_mm:g} mm",
                "sensor_size_mm": sensor,
                "effective_pixels": float(camera.size_px[0] * camera.size_px[1]),
                "nominal_focal_length_mm": camera.nominal_mm,
                "pixel_size_mm": camera.pitch_mm,
            },
            "campaign": {
                "method": "on-the-job calibration",
                "test_field": given.name,
                "platform": "multirotor, simulated",
                "flying_height_m": plan.passes[0].height_m,
                "exposure_time_s": camera.exposure_s,
                "forward_overlap": plan.passes[0].forward_overlap,
            },
        }
    )
    path.write_text(text, encoding="utf-8")


def simulate_flight(configuration: FlightConfiguration, folder: Path, advance: Advance) -> dict[str, Any]:
    """Simulate a flight and write `site/` and `truth/`."""
    world = make_world(configuration)
    site, truth = folder / "site", folder / "truth"
    site.mkdir(parents=True)
    if configuration.level == "card":
        write_card(world, site, advance)
        write_truth(world, truth, None, projected=True)
        return summary(world)
    observed = None if configuration.level == "pictures" else observe(world)
    if observed is not None and configuration.level == "block":
        block_folder.write_block(world, observed, site / "block")
    elif observed is not None:
        block_folder.write_observations(world, observed, site / "observations.csv")
        write_times(world, site / "times.csv")
    if configuration.level == "pictures":
        write_pictures(world, site / "images", advance)
    if configuration.level != "block":
        write_streams(world, make_streams(world), folder)
    write_project(world, site)
    write_particulars(world, site / "particulars.toml")
    write_truth(world, truth, observed, projected=configuration.level != "block")
    return summary(world)


def write_card(world: World, site: Path, advance: Advance) -> None:
    """Write pictures, surveyed points and the marks that a person made of them."""
    write_pictures(world, site / "images", advance)
    write_control(world, site)
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


MAKER = "simulated"
_EXIF, _GPS = 0x8769, 0x8825
_XMP = """<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"
 drone-dji:RelativeAltitude="{above:+.2f}"
 drone-dji:GimbalRollDegree="{roll:+.2f}"
 drone-dji:GimbalPitchDegree="{pitch:+.2f}"
 drone-dji:GimbalYawDegree="{yaw:+.2f}"/>
</rdf:RDF></x:xmpmeta>
<?xpacket end="w"?>"""


def write_pictures(world: World, folder: Path, advance: Callable[[float], None]) -> None:
    """Render and write all pictures that reach the office."""
    from PIL import Image

    given = world.configuration.pictures
    folder.mkdir(parents=True)
    scene = make_scene(world)
    # Made before the threads ask for it all at once.
    _ = scene.directions
    stamps, names = picture_stamps(world), world.exposures.names
    view = make_filter(world)
    places, _ = view.place(world.exposures.event_s)
    angles = np.degrees(view.angles(world.exposures.event_s))
    kept = np.flatnonzero(kept_images(world)).tolist()

    def make(number: int) -> None:
        """Render one picture and write it with its EXIF."""
        image = Image.fromarray(np.ascontiguousarray(render(scene, number)[..., ::-1]))
        exif = _exif(world, stamps[number], places[number], image.size)
        more: dict[str, Any] = {}
        if given.gimbal_xmp:
            above = float(places[number, 2]) - world.place.height_m - world.motion.ground_m
            roll, pitch, yaw = angles[number].tolist()
            # A camera that is fixed to the body looks down where the gimbal's pitch is -90.
            text = _XMP.format(above=above, roll=roll, pitch=pitch - 90, yaw=(yaw + 180) % 360 - 180)
            more["xmp"] = text.encode()
        path = folder / names[number]
        image.save(path, "JPEG", quality=given.quality, subsampling=0, exif=exif, **more)

    # Most of the time is spent outside the interpreter: threads share the painted ground.
    workers = 2
    with ThreadPoolExecutor(workers) as pool:
        for _ in pool.map(make, kept):
            advance(1 / len(kept))


def _exif(world: World, stamp: dt.datetime, place: Floats, size: tuple[int, int]) -> Any:
    from PIL import Image
    from PIL.TiffImagePlugin import IFDRational

    camera = world.configuration.camera
    taken = stamp.strftime("%Y:%m:%d %H:%M:%S")
    exif = Image.Exif()
    exif[0x010E] = LABEL
    exif[0x010F], exif[0x0110], exif[0x0132], exif[0x0112] = MAKER, camera.id, taken, 1
    photo = exif.get_ifd(_EXIF)
    photo[0x9003] = photo[0x9004] = taken
    if world.configuration.pictures.subseconds:
        photo[0x9291] = photo[0x9292] = f"{stamp.microsecond // 1000:03d}"
    photo[0x829A] = IFDRational(round(camera.exposure_s * 1e6), 1_000_000)
    photo[0x829D], photo[0x8827] = IFDRational(28, 10), 100
    photo[0x920A] = IFDRational(round(camera.nominal_mm * 1000), 1000)
    wide = camera.size_px[0] * camera.pitch_mm
    photo[0xA405] = round(camera.nominal_mm * 36 / wide)
    photo[0xA002], photo[0xA003] = size
    photo[0xA431] = f"{world.configuration.seed:04d}"
    gps = exif.get_ifd(_GPS)
    latitude, longitude = np.degrees(place[:2]).tolist()
    gps[1], gps[2] = "S" if latitude < 0 else "N", _sexagesimal(abs(latitude))
    gps[3], gps[4] = "W" if longitude < 0 else "E", _sexagesimal(abs(longitude))
    above_sea = float(place[2]) - world.configuration.place.geoid_m
    gps[5], gps[6] = b"\x01" if above_sea < 0 else b"\x00", IFDRational(round(abs(above_sea) * 1000), 1000)
    return exif


def _sexagesimal(degrees: float) -> tuple[Any, Any, Any]:
    from PIL.TiffImagePlugin import IFDRational

    whole, rest = divmod(round(degrees * 3600 * 100_000), 3600 * 100_000)
    minutes, seconds = divmod(rest, 60 * 100_000)
    return IFDRational(whole, 1), IFDRational(minutes, 1), IFDRational(seconds, 100_000)
