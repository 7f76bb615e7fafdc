"""The truth of a simulated flight, written aside: nothing that is processed refers to it."""

from pathlib import Path

import numpy as np

from acquire.simulate.world.block_folder import Columns, take_notes, toml_text, write_table
from acquire.simulate.world.camera import OPENCV, TrueCamera
from acquire.simulate.world.configuration import FlightConfiguration
from acquire.simulate.world.exposures import antenna_at, omega_phi_kappa
from acquire.simulate.world.observations import MeasuredPoints, kept_images
from acquire.simulate.world.place import Place
from acquire.simulate.world.world import World
from photocal.base.arrays import Floats
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
        "mistyped_control": take_notes(world, world.targets.surveyed_m).mistyped,
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
            "time_offset_is": "middle of the exposure less event",
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
            "latitude_deg": float(np.degrees(place.latitude)),
            "longitude_deg": float(np.degrees(place.longitude)),
            "height_m": place.height_m,
        },
        "crs": place.crs,
        "start_gps_ns": world.start_gps_ns,
        "duration_s": world.motion.duration_s,
    }


def conditions(given: FlightConfiguration) -> dict[str, object]:
    """Give what names a flight."""
    named = {"name": given.name, "seed": given.seed, "level": given.level.value}
    return {**named, "faults": sorted(fault.value for fault in given.faults)}


def _settings(world: World) -> str:
    """Give the configuration with everything that was not written into it, so that it can be flown again."""
    content = world.configuration.model_dump(by_alias=True, mode="json", exclude_none=True)
    content["faults"] = sorted(content["faults"])
    plan = content["plan"]
    passes = plan.pop("pass")
    tables = {key: value for key, value in content.items() if isinstance(value, dict)}
    sections = [("", {key: value for key, value in content.items() if key not in tables})]
    sections += [(f"[{name}]", keys) for name, keys in tables.items()]
    return toml_text(sections + [("[[plan.pass]]", keys) for keys in passes])


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
        **_columns(("X", "Y", "Z"), pose.centre_m, ".5f"),
        **_columns(("omega", "phi", "kappa"), angles, ".7f"),
        **_columns(("roll", "pitch", "yaw"), np.degrees(world.motion.angles(exposures.event_s)), ".6f"),
        **_columns(("antenna_X", "antenna_Y", "antenna_Z"), antenna, ".5f"),
    }
    if projected:
        grid = np.degrees(omega_phi_kappa(pose.rotation @ grid_to_local(world.place, pose.centre_m)))
        columns |= _columns(("E", "N", "h"), world.place.to_projected(pose.centre_m), ".5f")
        columns |= _columns(("omega_grid", "phi_grid", "kappa_grid"), grid, ".7f")
        columns |= _columns(("antenna_E", "antenna_N", "antenna_h"), world.place.to_projected(antenna), ".5f")
    write_table(path, columns)


def grid_to_local(place: Place, local_m: Floats, step_m: float = 10.0) -> Floats:
    """Give rotations from grid east, grid north, up at places to the local frame, shape (n, 3, 3)."""
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
    columns: Columns = {"point": ("", names), "role": ("", roles), **_columns(("X", "Y", "Z"), points, ".5f")}
    if projected:
        columns |= _columns(("E", "N", "h"), world.place.to_projected(points), ".5f")
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
            **_columns(("roll", "pitch", "yaw"), np.degrees(world.motion.angles(time)), ".6f"),
        },
    )


def _columns(names: tuple[str, ...], values: Floats, form: str) -> Columns:
    return {name: (form, values[:, k]) for k, name in enumerate(names)}
