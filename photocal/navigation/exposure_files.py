"""Exposures as files: `exposures.csv`, the block's `images.csv`, `geo.txt`, GeoPackage, picture."""

import datetime as dt
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError
from photocal.base.files import output_picture, write_rows
from photocal.base.geodesy import GeodeticPlace, enu_axes, enu_offsets
from photocal.block.model import Block, Images
from photocal.geometry.rotation import turned_left
from photocal.navigation.exposure_run import ExposureRun
from photocal.navigation.exposure_sources import ELLIPSOIDAL
from photocal.navigation.exposures import Exposures, names_cell, orientations, orientations_in_frame
from photocal.navigation.rig import CameraOnBody
from photocal.navigation.trajectory import COLUMNS, LARGEST_GAP_S, position_cells

COLOURS = {"fixed": "tab:green", "float": "tab:orange", "single": "tab:red"}
EVENT_COLUMNS = (
    *COLUMNS, "image", "roll_deg", "pitch_deg", "yaw_deg", "event", "note", "sroll", "spitch", "syaw",
    "above_take_off_m",
)  # fmt: skip
_ORIENTATION = ("X", "Y", "Z", "omega", "phi", "kappa")
IMAGE_COLUMNS = (
    "image", "camera", "X", "Y", "Z", "omega", "phi", "kappa", "sX", "sY", "sZ", "so", "sp", "sk",
)  # fmt: skip


def plot_exposures(run: ExposureRun, path: Path) -> None:
    """Draw where the exposures lie on the track, their heights, the timing, and the epochs around them."""
    minutes = (run.exposures.time.ns - run.exposures.time.ns[0]) / 60e9
    with output_picture(path, (11, 8), 10.0, 120) as figure:
        track, height, timing, gaps = figure.subplots(2, 2).ravel()
        if run.exposures.placed.placed.any():
            _places(run, minutes, track, height)
        _timing(run, minutes, timing)
        _gaps(run, minutes, gaps)


def _places(run: ExposureRun, minutes: Floats, track: Any, height: Any) -> None:
    p, t = run.exposures.placed, run.trajectory
    rows = p.placed
    origin = np.mean(p.place[rows], axis=0)
    if t is not None:
        east, north, _ = t.offsets(origin).T
        track.plot(east, north, "-", lw=0.5, color="0.7", zorder=0)
        since = (t.time.ns - run.exposures.time.ns[0]) / 60e9
        near = (since >= minutes[0]) & (since <= minutes[-1])
        height.plot(since[near], t.height_m[near], "-", lw=0.5, color="0.7", zorder=0)
    east, north, _ = p.offsets(origin).T
    sigma = p.sigma_m[:, 2]
    for status, colour in COLOURS.items():
        mask = rows & (p.status == status)
        if mask.any():
            track.plot(east[mask], north[mask], ".", ms=4, color=colour, label=f"{status} {int(mask.sum())}")
            bars = np.nan_to_num(sigma[mask])
            height.errorbar(minutes[mask], p.height_m[mask], bars, fmt=".", ms=4, lw=0.8, color=colour)
    track.legend()
    track.set(xlabel="east / m", ylabel="north / m", title="Exposures", aspect="equal")
    kind = "ellipsoidal" if run.exposures.height_kind.startswith("ell") else "kind: see summary"
    height.set(xlabel="time / min", ylabel=f"height / m ({kind})", title="Height with its sigma")


def _timing(run: ExposureRun, minutes: Floats, timing: Any) -> None:
    if run.cameras:
        for m in run.cameras:
            timing.plot(minutes[m.event], m.residual_s * 1e3, ".", ms=4, label=m.camera)
        timing.axhline(0.0, color="0.7", lw=0.8, zorder=0)
        timing.legend()
        title, label = "Event minus image, offset and drift removed", "residual / ms"
    else:
        timing.plot(minutes[1:], np.diff(run.exposures.time.ns) / 1e9, ".", ms=4)
        timing.set_ylim(bottom=0.0)
        title, label = "From exposure to exposure", "interval / s"
    timing.set(xlabel="time / min", ylabel=label, title=title)


def _gaps(run: ExposureRun, minutes: Floats, gaps: Any) -> None:
    # Longer gaps stand at the border of the figure.
    shown_gap_s = 60.0
    gap = run.exposures.placed.gap_s
    beyond = ~(gap <= shown_gap_s)
    gaps.plot(minutes[~beyond], gap[~beyond], ".", ms=4)
    if beyond.any():
        gaps.plot(
            minutes[beyond],
            np.full(int(beyond.sum()), shown_gap_s),
            "^",
            ms=4,
            color="tab:red",
            label=f"over {shown_gap_s:g} s, or outside the trajectory",
        )
    gaps.axhline(LARGEST_GAP_S, color="k", lw=0.8, label=f"{LARGEST_GAP_S:g} s: placed below")
    gaps.set_ylim(0.0, max(2 * LARGEST_GAP_S, 1.1 * float(np.max(np.minimum(gap, shown_gap_s)))))
    gaps.ticklabel_format(useOffset=False)
    gaps.legend()
    gaps.set(xlabel="time / min", ylabel="epochs apart / s", title="Epochs around each event")


def write_exposures(path: Path, exposures: Exposures) -> None:
    """Write one row per event; what has no position says why in `note`."""
    p = exposures.placed
    all_angles, all_sigmas = exposures.angles, np.degrees(exposures.angle_sigma)
    second = exposures.above_take_off_m
    rows = []
    for i in range(len(exposures)):
        cells = position_cells(p, i) if p.placed[i] else [""] * 10
        angles = ["" if np.isnan(v) else f"{np.degrees(v):.5f}" for v in all_angles[i].tolist()]
        angles[2] = angles[2] and f"{float(angles[2]) % 360:.5f}"
        row = [int(exposures.time.ns[i]), *cells, names_cell(exposures.images[i]), *angles]
        spread = ["" if np.isnan(v) else f"{v:.5f}" for v in all_sigmas[i].tolist()]
        above = "" if second is None or np.isnan(second[i]) else f"{second[i]:.3f}"
        rows.append([*row, int(exposures.number[i]), exposures.reason(i), *spread, above])
    write_rows(path, EVENT_COLUMNS, rows)


def with_images(exposures: Exposures) -> Integers:
    """Return the rows that have a position and exactly the name of an image (or several cameras' ones)."""
    named = np.array([bool(names) for names in exposures.images])
    return np.flatnonzero(exposures.placed.placed & named)


def write_block_images(
    path: Path, exposures: Exposures, camera: str, rig: CameraOnBody | None, crs: str | None
) -> dict[str, Any]:
    """Write the block's `images.csv`, the full covariances beside it; return the coordinates' frame.

    path: the file; ``covariance.parquet`` in the same folder has the lower triangle, row by row, of X, Y, Z
        (m), omega, phi, kappa (deg) of every image, as a run folder has it.
    camera: the camera's id in the block.
    rig: camera axes and boresight; None: a camera that looks down, the upper edge of its image forward.
    crs: coordinate reference system of X, Y, Z; without: topocentric (east, north, up) about the middle.
    returns: ``frame`` and, where it is local, the origin.
    """
    rows, xyz, (angles, covariance), frame = _oriented(exposures, rig or CameraOnBody(), crs)
    unit = np.array([1.0, 1.0, 1.0, *[180 / np.pi] * 3])
    covariance = covariance * unit[:, None] * unit
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    lines, names, kept = [], [], []
    for k, row in enumerate(rows.tolist()):
        place = [f"{v:.4f}" for v in xyz[k].tolist()]
        turned = ["" if np.isnan(v) else f"{v:.6f}" for v in np.degrees(angles[k]).tolist()]
        sigmas = ["" if np.isnan(v) else f"{v:.5f}" for v in sigma[k].tolist()]
        for name in exposures.images[row]:
            lines.append([name, camera, *place, *turned, *sigmas])
            if np.isfinite(covariance[k]).all():
                names.append(name)
                kept.append(covariance[k][np.tril_indices(6)])
    write_rows(path, IMAGE_COLUMNS, lines)
    _write_covariances(path.with_name("covariance.parquet"), names, kept)
    return frame


def _oriented(
    exposures: Exposures, rig: CameraOnBody, crs: str | None
) -> tuple[Integers, Floats, tuple[Floats, Floats], dict[str, Any]]:
    """Rows with images, their coordinates, angles with covariances, and the frame of all these."""
    rows, p = with_images(exposures), exposures.placed
    place = p.place[rows]
    lat, lon, height = place.T
    xyz, turn, frame = in_frame(lat, lon, height, np.mean(place, axis=0), crs)
    rotation, covariance = orientations(exposures, rig)
    return rows, xyz, orientations_in_frame(rotation[rows], covariance[rows], turn), frame


def _write_covariances(path: Path, names: list[str], lower: list[Floats]) -> None:
    import pyarrow as pa
    import pyarrow.parquet

    table = {
        "kind": pa.array(["image"] * len(names), pa.string()),
        "id": pa.array(names, pa.string()),
        "names": pa.array([list(_ORIENTATION)] * len(names), pa.list_(pa.string())),
        "lower": pa.array(lower, pa.list_(pa.float64())),
    }
    pyarrow.parquet.write_table(pa.table(table), path)


def in_frame(
    lat: Floats, lon: Floats, height: Floats, origin: Floats, crs: str | None
) -> tuple[Floats, Floats, dict[str, Any]]:
    """Coordinates, turns from local east, north, up, and the frame: a system, or topocentric at `origin`."""
    if crs is not None:
        return *projected(lat, lon, height, crs), {"frame": crs}
    turn = enu_axes(*origin[:2]) @ np.swapaxes(enu_axes(lat, lon), 1, 2)
    frame = {"frame": "local", "origin_lat_lon_height": origin.tolist()}
    return enu_offsets(lat, lon, height, origin), turn, frame


def projected(lat: Floats, lon: Floats, height: Floats, crs: str) -> tuple[Floats, Floats]:
    """Return coordinates in a CRS and the rotation (n, 3, 3) from east, north, up to its axes."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    try:
        way = Transformer.from_crs("EPSG:4979", crs, always_xy=True, allow_ballpark=False, only_best=True)
        east, north, up = way.transform(lon, lat, height, errcheck=True)
        east_n, north_n, _ = way.transform(lon, lat + 1e-5, height, errcheck=True)
    except ProjError as refusal:
        raise ConfigurationError(
            f"positions cannot be transformed to {crs} ({refusal})",
            "name a system that covers the place, with its geoid grid installed",
            where=crs,
        ) from refusal
    turn = turned_left(np.arctan2(east_n - east, north_n - north))
    return np.stack([east, north, up], axis=1), turn


def write_geo_txt(path: Path, exposures: Exposures, rig: CameraOnBody) -> str:
    """Write OpenDroneMap's `geo.txt` on EPSG:4326: place, and where they are known angles and accuracies.

    There a name ends at its first blank: with such names the file is left out, and the reason is returned.

    rig: camera axes and boresight: the angles are the camera's, see `photocal.exchange.ground_points`.
    """
    from photocal.exchange.ground_points import angles_of_geo, write_geo

    p = exposures.placed
    angles = angles_of_geo(orientations(exposures, rig)[0])
    east, north, up = p.sigma_m.T
    places = np.column_stack([np.round(p.lon_deg, 10), np.round(p.lat_deg, 10), np.round(p.height_m, 4)])
    turned = np.column_stack([np.round(angles, 5), np.round(np.hypot(east, north), 4), np.round(up, 4)])
    # The accuracies follow the angles: without these there is no place for them.
    turned[~np.isfinite(angles).all(axis=1)] = np.nan
    values = np.hstack([places, turned]).tolist()
    rows = with_images(exposures).tolist()
    torn = next((name for row in rows for name in exposures.images[row] if name.split() != [name]), "")
    if torn:
        path.unlink(missing_ok=True)
        return f"left out: names in it end at a blank, and {torn!r} has one"
    write_geo(path, "EPSG:4326", {name: values[row] for row in rows for name in exposures.images[row]})
    return ""


def write_geopackage_of(
    path: Path, exposures: Exposures, rig: CameraOnBody, camera: str, changed_utc: str
) -> None:
    """Write the exposures with image and position for a GIS: WGS 84, angles in the topocentric frame."""
    from photocal.exchange.exporting import Choices
    from photocal.exchange.geographic import write_geopackage
    from photocal.geometry.camera import camera as nominal

    rows, xyz, (angles, covariance), frame = _oriented(exposures, rig, None)
    origin = GeodeticPlace(*frame["origin_lat_lon_height"])
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))[:, [3, 4, 5, 0, 1, 2]]
    names = [exposures.images[row] for row in rows.tolist()]
    every = np.repeat(np.arange(len(rows)), [len(of_row) for of_row in names])
    images = Images(
        tuple(name for of_row in names for name in of_row),
        np.zeros(len(every), np.int64),
        np.hstack([angles, xyz])[every],
        sigma[every],
    )
    # Without points there are no footprints: the camera gives its name only.
    unknown = nominal(camera, "brown-ideal", "px", (2, 2), (1.0, 1.0), {"c": 1.0})
    given = Block("exposures", "local", "", "free", (unknown,), images)
    write_geopackage(path, given, Choices(origin=origin, changed_utc=changed_utc))


def write_run(
    folder: Path, run: ExposureRun, rig: CameraOnBody, camera: str, crs: str | None
) -> dict[str, Any]:
    """Write tables, GeoPackage and plot; return the figures with the frame of `images.csv`.

    raises ConfigurationError: when the kind of the heights does not allow that system.
    """
    figures = dict(run.figures)
    write_exposures(folder / "exposures.csv", run.exposures)
    if len(with_images(run.exposures)):
        if crs is not None and run.exposures.height_kind != ELLIPSOIDAL:
            raise ConfigurationError(
                f"heights are {run.exposures.height_kind}: they cannot be transformed to {crs}",
                "leave out --crs",
                where="--crs",
            )
        figures["images_csv"] = write_block_images(folder / "images.csv", run.exposures, camera, rig, crs)
        left_out = write_geo_txt(folder / "geo.txt", run.exposures, rig)
        figures |= {"geo_txt": left_out} if left_out else {}
        changed = dt.datetime.now(dt.UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        write_geopackage_of(folder / "exposures.gpkg", run.exposures, rig, camera, changed)
    plot_exposures(run, folder / "exposures.png")
    return figures
