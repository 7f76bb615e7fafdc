"""Exposures as files: `exposures.csv`, the block's `images.csv`, and `geo.txt`."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from photocal.adjustment.mounting import NADIR
from photocal.geometry.body import object_to_body
from photocal.geometry.rotation import angles_from_matrix
from photocal.navigation.exposures import Exposures
from photocal.navigation.trajectory import COLUMNS, covariance_cells, enu_axes, geocentric

Floats = NDArray[np.float64]
EVENT_COLUMNS = (*COLUMNS, "image", "roll_deg", "pitch_deg", "yaw_deg", "event", "note")
IMAGE_COLUMNS = (
    "image", "camera", "X", "Y", "Z", "omega", "phi", "kappa", "sX", "sY", "sZ", "so", "sp", "sk",
)  # fmt: skip


def write_exposures(path: Path, exposures: Exposures) -> None:
    """Write one row per event; what has no position says why in `note`."""
    p = exposures.placed
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(EVENT_COLUMNS)
        for i in range(len(exposures)):
            cells = [""] * 10
            if p.placed[i]:
                position = (f"{p.lat_deg[i]:.10f}", f"{p.lon_deg[i]:.10f}", f"{p.height_m[i]:.4f}")
                known = np.isfinite(p.covariance_m2[i]).all()
                sigmas = covariance_cells(p.covariance_m2[i]) if known else [""] * 6
                cells = [*position, str(p.status[i]), *sigmas]
            angles = ["" if np.isnan(v) else f"{np.degrees(v):.5f}" for v in exposures.angles[i].tolist()]
            angles[2] = angles[2] and f"{float(angles[2]) % 360:.5f}"
            note = exposures.reason(i)
            row = [int(exposures.time.ns[i]), *cells, exposures.image[i], *angles]
            writer.writerow([*row, int(exposures.number[i]), note])


def with_images(exposures: Exposures) -> NDArray[np.int64]:
    """Return the rows that have a position and exactly the name of an image (or several cameras' ones)."""
    named = np.array([bool(name) for name in exposures.image])
    return np.flatnonzero(exposures.placed.placed & named)


def write_block_images(
    path: Path, exposures: Exposures, camera: str, angle_sigma: Floats | None, crs: str | None
) -> dict[str, Any]:
    """Write the block's `images.csv` and return the frame of its coordinates.

    Parameters
    ----------
    path : Path
        The file.
    exposures : Exposures
        Those with position and image are written.
    camera : str
        The camera's id in the block.
    angle_sigma : float64 (3,) or None
        Standard deviations of roll, pitch, yaw, rad; without them the angles are start values.
    crs : str or None
        Coordinate reference system of X, Y, Z; without: topocentric (east, north, up) about the middle.

    Returns
    -------
    dict
        ``frame`` and, where it is local, the origin.
    """
    rows = with_images(exposures)
    p = exposures.placed
    lat, lon, height = p.lat_deg[rows], p.lon_deg[rows], p.height_m[rows]
    if crs is None:
        origin = np.array([np.mean(lat), np.mean(lon), np.mean(height)])
        centre = geocentric(origin[None, 0], origin[None, 1], origin[None, 2])
        axes = enu_axes(float(origin[0]), float(origin[1]))
        xyz = (geocentric(lat, lon, height) - centre) @ axes.T
        turn = np.array([axes @ enu_axes(a, b).T for a, b in zip(lat.tolist(), lon.tolist(), strict=True)])
        frame: dict[str, Any] = {"frame": "local", "origin_lat_lon_height": origin.tolist()}
    else:
        xyz, turn = projected(lat, lon, height, crs)
        frame = {"frame": crs}
    body, _ = object_to_body(exposures.angles[rows])
    # The camera looks down with the upper edge of the image forward; ENU axes into those of the frame.
    rotation = NADIR @ body @ np.swapaxes(turn, 1, 2)
    angles = np.degrees(angles_from_matrix(rotation))
    covariance = turn @ p.covariance_m2[rows] @ np.swapaxes(turn, 1, 2)
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(IMAGE_COLUMNS)
        for k, row in enumerate(rows.tolist()):
            # Roll turns about the flight direction, pitch across it: for a nadir camera the larger of both
            # bounds omega and phi whatever the heading.
            tilt = "" if angle_sigma is None else f"{np.degrees(max(angle_sigma[:2])):.5f}"
            heading = "" if angle_sigma is None else f"{np.degrees(angle_sigma[2]):.5f}"
            turned = ["" if np.isnan(v) else f"{v:.6f}" for v in angles[k].tolist()]
            own = ["" if np.isnan(v) else f"{v:.5f}" for v in sigma[k].tolist()]
            place = [f"{v:.4f}" for v in xyz[k].tolist()]
            sigmas = [tilt, tilt, heading] if turned[0] else ["", "", ""]
            for name in exposures.image[row].split():
                writer.writerow([name, camera, *place, *turned, *own, *sigmas])
    return frame


def projected(lat: Floats, lon: Floats, height: Floats, crs: str) -> tuple[Floats, Floats]:
    """Return coordinates in a CRS and the rotation (n, 3, 3) from east, north, up to its axes."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    from drivers.errors import ConfigurationError

    try:
        way = Transformer.from_crs("EPSG:4979", crs, always_xy=True, allow_ballpark=False, only_best=True)
        east, north, up = way.transform(lon, lat, height, errcheck=True)
        east_n, north_n, _ = way.transform(lon, lat + 1e-5, height, errcheck=True)
    except ProjError as refusal:
        raise ConfigurationError(
            f"positions cannot be taken to {crs} ({refusal})",
            where="--crs",
            remedy="name a system that covers the place, with its geoid grid installed",
        ) from refusal
    convergence = np.arctan2(east_n - east, north_n - north)
    s, c, zero, one = np.sin(convergence), np.cos(convergence), np.zeros_like(lat), np.ones_like(lat)
    turn = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]])
    return np.stack([east, north, up], axis=1), np.moveaxis(turn, -1, 0)


def write_geo_txt(path: Path, exposures: Exposures) -> None:
    """Write OpenDroneMap's `geo.txt`: image, longitude, latitude, height on EPSG:4326."""
    rows = with_images(exposures)
    p = exposures.placed
    lines = [
        f"{name} {p.lon_deg[row]:.10f} {p.lat_deg[row]:.10f} {p.height_m[row]:.4f}"
        for row in rows.tolist()
        for name in exposures.image[row].split()
    ]
    path.write_text("\n".join(["EPSG:4326", *lines]) + "\n", encoding="utf-8")
