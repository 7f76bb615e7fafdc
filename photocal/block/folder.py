"""Reading a block folder: block.toml, images, points and observations."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.adjustment.lasers import NO_LASERS, LaserDistances
from photocal.adjustment.network import ANGLES, NO_RELATIONS, RELATIONS, Relations, covariance_matrices
from photocal.base.arrays import Floats
from photocal.base.checked_toml import read_toml
from photocal.base.errors import ConfigurationError, IllPosedError, InputMalformedError, InputNotFoundError
from photocal.base.text_tables import TextTable, known_rows, read_table, refuse
from photocal.block.camera_setup import make_camera
from photocal.block.model import (
    ROLES,
    Block,
    FiducialFit,
    Images,
    ObjectPoints,
    Observations,
    Repetition,
    fingerprint,
)
from photocal.block.motion import MOTION_COLUMNS, read_motion
from photocal.block.mounting import make_mounting, read_attitudes, read_positions
from photocal.block.rig import make_heads
from photocal.block.setup import LaserKeys, ObservationKeys, Setup
from photocal.geometry.camera import Camera
from photocal.geometry.interior import Transformation, interior_orientation

SETUP, MARKS, READINGS = "block.toml", "fiducials.csv", "fiducial_readings.csv"
# How the marks fitted in a block that was read with `readings` and written again.
FIDUCIAL_FITS = "fiducial_fits.csv"
IMAGE_COLUMNS = ("image", "camera", "X", "Y", "Z", "omega", "phi", "kappa")
IMAGE_SIGMAS = ("so", "sp", "sk", "sX", "sY", "sZ")
EXPOSURE = "exposure"
POINT_COLUMNS = ("point", "X", "Y", "Z", "role")
POINT_SIGMAS = ("sX", "sY", "sZ")
POINT_CROSS = ("sXY", "sXZ", "sYZ")
OBSERVATION_COLUMNS = ("image", "point", "x", "y")
# Observations between points stand in tables of their plural: distances.csv (m), height_differences.csv (m),
# angles (degrees, azimuths from the Y axis towards X), lines.csv (m).
CHECK_DISTANCES = "check_distances.csv"
# Laser distances of images, and the points about their targets.
LASER_DISTANCES, CORNERS = "laser_distances.csv", ("first", "second", "third")


def from_readings(
    folder: Path,
    transformation: Transformation,
    cameras: tuple[Camera, ...],
    images: Images,
    observations: Observations,
) -> tuple[Observations, tuple[FiducialFit, ...]]:
    """Turn the readings of every image into image coordinates."""
    if (observations.unit, observations.axes) != ("mm", "photo"):
        raise ConfigurationError(
            "readings become image coordinates in mm, x right and y up",
            'give unit = "mm" and axes = "photo" beside readings',
            where=folder / SETUP,
        )
    marks = read_table(folder / MARKS, ("camera", "fiducial", "x", "y"))
    camera = known_rows(marks, "camera", tuple(interior.id for interior in cameras), SETUP)
    index, fiducials = marks.names("fiducial")
    known = marks.matrix("xy")
    place = {(int(k), fiducials[n]): row for row, (k, n) in enumerate(zip(camera, index, strict=True))}
    table = read_table(folder / READINGS, ("image", "fiducial", "x", "y"))
    image = known_rows(table, "image", images.names, "images.csv")
    index, fiducials = table.names("fiducial")
    read = np.array(fiducials)[index]
    rows = [place.get((int(images.camera[i]), str(name)), -1) for i, name in zip(image, read, strict=True)]
    mark = np.array(rows, dtype=np.int64)
    refuse(table, mark < 0, "the camera has no such fiducial", f"correct it, or add it to {MARKS}")
    values = table.matrix("xy")
    plane, fits = observations.values.copy(), []
    for i, name in enumerate(images.names):
        here, seen = image == i, observations.image == i
        if not seen.any() and not here.any():
            continue
        try:
            fit = interior_orientation(values[here], known[mark[here]], transformation, tuple(read[here]))
        except IllPosedError as refusal:
            raise IllPosedError(
                refusal.what, refusal.remedy, where=f"{folder / READINGS}, image {name}"
            ) from refusal
        plane[seen] = fit.applied(observations.values[seen])
        fits.append(FiducialFit(name, tuple(map(str, read[here])), fit.residuals, fit.redundancy, fit.sigma0))
    return replace(observations, values=plane), tuple(fits)


def mean_of_readings(
    readings: Observations, limit: float, path: Path, images: tuple[str, ...], points: tuple[str, ...]
) -> tuple[Observations, Repetition]:
    """Take the mean of repeated readings of a point in an image, each with the same weight.

    A reading that is farther than the limit from the median of its group, in x or y, is rejected. The stated
    standard deviation is that of one reading: the mean of n has it by the root of n.

    raises InputMalformedError: when no two readings of a point agree, so that none can stay.
    """
    pair = readings.image * len(points) + readings.point
    order = np.argsort(pair, kind="stable")
    _, first, count = np.unique(pair[order], return_index=True, return_counts=True)
    group = np.repeat(np.arange(len(first)), count)
    values = readings.values[order]
    middle = np.array([np.median(values[a : a + n], axis=0) for a, n in zip(first, count, strict=True)])
    kept = (np.abs(values - middle[group]) <= limit).all(axis=1)
    stays = np.bincount(group[kept], minlength=len(first))
    if (stays == 0).any():
        worst = order[first[int(np.argmin(stays))]]
        point, image = points[readings.point[worst]], images[readings.image[worst]]
        raise InputMalformedError(
            f"the readings of point {point} in image {image} lie more than {limit:g} {readings.unit} apart",
            "read the point again, or give a wider rejection_limit in [observations]",
            where=path,
        )
    group, values, variance = group[kept], values[kept], readings.sigma[order][kept] ** 2
    sums = np.zeros((len(first), 4))
    np.add.at(sums, group, np.hstack([values, variance]))
    mean, variance = np.hsplit(sums / stays[:, None], 2)
    redundancy = int((stays - 1).sum())
    x, y = np.sqrt(((values - mean[group]) ** 2).sum(axis=0) / max(redundancy, 1)).tolist()
    spread = (x, y) if redundancy else None
    counts = len(kept), int((~kept).sum()), limit, int(stays.min()), int(stays.max()), spread
    chosen = order[first]
    of_mean = np.sqrt(variance / stays[:, None])
    means = replace(
        readings, image=readings.image[chosen], point=readings.point[chosen], values=mean, sigma=of_mean
    )
    return means, Repetition(*counts)


def read_block(folder: Path) -> Block:
    """Read a block folder.

    raises InputNotFoundError: for a missing or empty file.
    raises ConfigurationError: for a wrong key or value in block.toml.
    raises InputMalformedError: for a wrong table or cell, an unknown name, or a name that comes twice.
    """
    if not folder.is_dir():
        what = "is a file, a block folder was expected" if folder.exists() else "does not exist"
        raise InputNotFoundError(what, "name the folder that has block.toml", where=folder)
    setup = read_toml(folder / SETUP, Setup)
    cameras = tuple(make_camera(keys, folder / SETUP) for keys in setup.camera)
    if len({camera.id for camera in cameras}) < len(cameras):
        raise ConfigurationError("two cameras have the same id", "rename one", where=folder / SETUP)
    images = read_images(folder / "images.csv", cameras)
    points = read_points(folder / "points.csv")
    table, text = folder / "observations.parquet", folder / "observations.csv"
    if table.exists() and text.exists():
        what = "has both observations.csv and observations.parquet"
        raise InputMalformedError(what, "keep one of them", where=folder)
    table = table if table.exists() else text
    observations, repetition = read_observations(table, setup.observations, images.names, points.names)
    readings = setup.observations.readings
    repetition = repetition or setup.observations.repetition
    if readings is not None:
        observations, fits = from_readings(folder, readings, cameras, images, observations)
    else:
        fits = read_fits(folder / FIDUCIAL_FITS, images.names)
    paths = {name: folder / f"{name}s.csv" for name in RELATIONS}
    parts = [read_relations(path, name, points.names) for name, path in paths.items() if path.exists()]
    relations = parts[0].plus(*parts[1:]) if parts else NO_RELATIONS
    checks = folder / CHECK_DISTANCES
    named = (*RELATIONS, "position", "attitude")
    optional = (
        *(f"{name}s.csv" for name in named),
        *(CHECK_DISTANCES, LASER_DISTANCES),
        *([] if readings else [FIDUCIAL_FITS]),
    )
    present = [name for name in optional if (folder / name).exists()]
    tables = [SETUP, "images.csv", "points.csv", table.name, *present, *_priors(folder, setup)]
    tables += [MARKS, READINGS] if readings is not None else []
    positions = read_positions(
        folder / "positions.csv", images.names, setup.mounting.height_scale_from_m or 0.0
    )
    attitudes = read_attitudes(folder / "attitudes.csv", images.names)
    strips = int(positions.strip.max()) + 1 if len(positions.strip) else 0
    datum = setup.block.datum
    return Block(
        name=setup.block.name or folder.resolve().name,
        frame=setup.block.frame,
        height=setup.block.height,
        datum=datum if isinstance(datum, str) else "free",
        cameras=cameras,
        images=images,
        points=points,
        observations=observations,
        inputs=tuple(fingerprint(folder / name, name) for name in tables),
        datum_points=tuple(setup.block.datum_points if isinstance(datum, str) else datum),
        relations=relations,
        positions=positions,
        attitudes=attitudes,
        mounting=make_mounting(setup.mounting, strips),
        fiducial_fits=fits,
        repetition=repetition,
        global_test=(setup.block.level, setup.block.global_test),
        check_distances=read_relations(checks, "distance", points.names) if checks.exists() else NO_RELATIONS,
        heads=make_heads(setup.head, [camera.id for camera in cameras], folder / SETUP),
        refraction=setup.block.refraction,
        curvature=setup.block.curvature,
        lasers=read_lasers(folder / LASER_DISTANCES, setup.laser, images.names, points.names),
    )


def _priors(folder: Path, setup: Setup) -> list[str]:
    """Files of the calibrations that cameras take their prior from: they go along with the block."""
    names = []
    for keys in setup.camera:
        if not keys.prior_from:
            continue
        path = folder / keys.prior_from
        if not path.resolve().is_relative_to(folder.resolve()):
            raise ConfigurationError(
                f"prior_from of camera {keys.id} lies outside of the block folder",
                "copy that result.json into the folder, so that the block is complete",
                where=folder / SETUP,
            )
        names.append(path.resolve().relative_to(folder.resolve()).as_posix())
    return list(dict.fromkeys(names))


def read_fits(path: Path, images: tuple[str, ...]) -> tuple[FiducialFit, ...]:
    """Read how fiducial marks fitted; errors as for `read_block`."""
    if not path.exists():
        return ()
    table = read_table(path, ("image", "fiducial", "vx", "vy", "redundancy", "sigma0"))
    image = known_rows(table, "image", images, "images.csv")
    index, fiducials = table.names("fiducial")
    residuals, redundancy = table.matrix(("vx", "vy")), table.numbers("redundancy")
    sigma0 = table.numbers("sigma0", empty=np.nan)
    rows_of = [np.flatnonzero(image == k) for k in dict.fromkeys(image.tolist())]
    return tuple(
        FiducialFit(
            images[image[rows[0]]],
            tuple(fiducials[k] for k in index[rows]),
            residuals[rows],
            int(redundancy[rows[0]]),
            float(sigma0[rows[0]]),
        )
        for rows in rows_of
    )


def read_images(path: Path, cameras: tuple[Camera, ...]) -> Images:
    """Read `images.csv`; parameters and errors as for `read_block`."""
    table = read_table(path, IMAGE_COLUMNS, (*IMAGE_SIGMAS, *MOTION_COLUMNS, EXPOSURE))
    names = table.unique_names("image")
    camera = known_rows(table, "camera", tuple(camera.id for camera in cameras), "block.toml")
    # Empty cells ask for start values; what has a sigma must be given.
    values = table.matrix(("omega", "phi", "kappa", "X", "Y", "Z"), empty=np.nan)
    sigma = np.column_stack([_sigmas(table, c) for c in IMAGE_SIGMAS])
    for part, what in ((slice(0, 3), "angles"), (slice(3, 6), "coordinates")):
        empty = np.isnan(values[:, part])
        torn = empty.any(axis=1) & ~empty.all(axis=1)
        refuse(table, torn, f"some of the {what} are empty", "give all three or none")
    observed = (np.isnan(values) & np.isfinite(sigma)).any(axis=1)
    refuse(table, observed, "a value with a sigma is empty", "give the value")
    values[:, :3] = np.radians(values[:, :3])
    sigma[:, :3] = np.radians(sigma[:, :3])
    exposure = table.texts(EXPOSURE) if table.has(EXPOSURE) else ()
    return Images(names, camera, values, sigma, *read_motion(table), exposure)


def read_points(path: Path) -> ObjectPoints:
    """Read `points.csv`; errors as for `read_block`."""
    table = read_table(path, POINT_COLUMNS, POINT_SIGMAS + POINT_CROSS)
    names = table.unique_names("point")
    role = known_rows(table, "role", ROLES, f"({', '.join(ROLES)})")
    values = table.matrix("XYZ", empty=np.nan)
    sigma = np.column_stack([_sigmas(table, c) for c in POINT_SIGMAS])
    control, tie = role == ROLES.index("control"), role == ROLES.index("tie")
    torn, surveyed = np.isnan(values).any(axis=1), np.isfinite(sigma).any(axis=1)
    refuse(table, ~tie & torn, "a control or check point lacks a coordinate", "give X, Y and Z")
    refuse(table, tie & surveyed, "a tie point has a sigma", "make it control, or leave the sigmas empty")
    remedy = "give sX, sY or sZ (0 holds a coordinate)"
    refuse(table, control & ~surveyed, "a control point has no sigma", remedy)
    return ObjectPoints(names, values, sigma, role, _cross(table, sigma))


def _cross(table: TextTable, sigma: Floats) -> Floats | None:
    """Covariances between the coordinates of a point, where all three have a sigma; None without any."""
    if not any(map(table.has, POINT_CROSS)):
        return None
    cross = table.matrix(POINT_CROSS, empty=0.0)
    linked = cross.any(axis=1)
    whole = np.asarray((np.isfinite(sigma) & (sigma > 0)).all(axis=1))
    remedy = "give sX, sY and sZ with covariances that fit them (m^2)"
    refuse(table, linked & ~whole, "a covariance is given without its sigma", remedy)
    matrix = covariance_matrices(np.where(whole[:, None], sigma, 1.0), cross * whole[:, None])
    refuse(table, np.linalg.eigvalsh(matrix)[:, 0] <= 0, "the covariance is not positive definite", remedy)
    return cross


def read_observations(
    path: Path, keys: ObservationKeys, images: tuple[str, ...], points: tuple[str, ...]
) -> tuple[Observations, Repetition | None]:
    """Read `observations.csv`; errors as for `read_block`."""
    table = read_table(path, OBSERVATION_COLUMNS, ("sx", "sy"))
    image = known_rows(table, "image", images, "images.csv")
    point = known_rows(table, "point", points, "points.csv")
    pair = image * len(points) + point
    _, first = np.unique(pair, return_index=True)
    again = np.ones(len(pair), dtype=np.bool_)
    again[first] = keys.rejection_limit is not None
    if keys.rejection_limit is None:
        remedy = "keep one of the observations; for repeated readings give rejection_limit in [observations]"
        refuse(table, again, "the point was already observed in this image", remedy)
    common = keys.sigma if isinstance(keys.sigma, tuple) else (keys.sigma, keys.sigma)
    sigma = np.column_stack(
        [table.numbers(c, empty=s or np.nan) for c, s in zip(("sx", "sy"), common, strict=True)]
    )
    none, remedy = np.isnan(sigma).any(axis=1), "give sx and sy, or sigma in [observations]"
    refuse(table, none, "the observation has no sigma", remedy)
    wrong = (sigma <= 0).any(axis=1)
    refuse(table, wrong, "the sigma of an observation is not positive", "give a positive number")
    observations = Observations(keys.unit, keys.axes, image, point, table.matrix("xy"), sigma)
    if keys.rejection_limit is None:
        return observations, None
    return mean_of_readings(observations, keys.rejection_limit, path, images, points)


def read_relations(path: Path, kind: str, points: tuple[str, ...], known: str = "points.csv") -> Relations:
    """Read a table of observations between points; errors as for `read_block`."""
    columns = RELATIONS[kind]
    table = read_table(path, (*columns, *(() if kind == "line" else ("value",)), "sigma"))
    ends = np.array([known_rows(table, column, points, known) for column in columns])
    sigma = table.numbers("sigma")
    value = np.zeros(len(sigma)) if kind == "line" else table.numbers("value")
    same = (np.diff(np.sort(ends, axis=0), axis=0) == 0).any(axis=0)
    refuse(table, same, "the same point is named twice", f"name {len(columns)} points")
    refuse(table, sigma <= 0, "sigma is not positive", "give a standard deviation")
    refuse(table, (value <= 0) & (kind == "distance"), "the distance is not positive", "correct it")
    code = np.full(len(value), list(RELATIONS).index(kind))
    scale = np.pi / 180 if kind in ANGLES else 1.0
    third = ends[2] if len(ends) == 3 else np.full(len(value), -1)
    return Relations(code, ends[0], ends[1], value * scale, sigma * scale, third)


def read_lasers(
    path: Path, keys: LaserKeys | None, images: tuple[str, ...], points: tuple[str, ...]
) -> LaserDistances:
    """Read laser distances, if there are any; errors as for `read_block`."""
    if not path.exists():
        return NO_LASERS
    if keys is None:
        raise ConfigurationError(
            f"{path.name} needs the errors common to its distances",
            "give [laser] with offset_sigma_m and scale_sigma in block.toml",
            where=path.parent / SETUP,
        )
    table = read_table(path, ("image", *CORNERS, "value", "sigma"))
    image = known_rows(table, "image", images, "images.csv")
    corners = np.column_stack([known_rows(table, corner, points, "points.csv") for corner in CORNERS])
    value, sigma = table.numbers("value"), table.numbers("sigma")
    same = (np.diff(np.sort(corners, axis=1), axis=1) == 0).any(axis=1)
    refuse(table, same, "the same point is named twice", "name three points about the target")
    refuse(table, value <= 0, "the distance is not positive", "correct it")
    refuse(table, sigma <= 0, "sigma is not positive", "give a standard deviation")
    offset = np.inf if keys.offset_sigma_m == "free" else keys.offset_sigma_m
    return LaserDistances(image, corners, value, sigma, (float(offset), keys.scale_sigma))


def _sigmas(table: TextTable, column: str) -> Floats:
    """Standard deviations; an empty cell leaves the value free."""
    sigma = table.numbers(column, empty=np.inf)
    refuse(table, sigma < 0, f"{column} is negative", "give a standard deviation")
    return sigma
