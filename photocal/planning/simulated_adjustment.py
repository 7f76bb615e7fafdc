"""Precision of a planned flight, from the adjustment that will be made of it.

The planned exposures, a net of tie points and the suggested ground points make a network whose
observations are free of errors; its covariance is that of the flight as planned. Errors of the
model, of the terrain and of the weather are not in it.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, point_weights
from photocal.base.arrays import Floats, Integers, picked
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import PARAMETERS, Camera, among
from photocal.geometry.rotation import matrix_from_angles
from photocal.planning.area import grid
from photocal.planning.flight import Layout, PlannedFlight
from photocal.planning.options import PrecisionOptions

SELF_CALIBRATION = ("c", "x0", "y0", "K1", "K2", "P1", "P2")


@dataclass(frozen=True)
class SimulatedPrecision:
    """What the simulated adjustment says.

    check: check points that two photos or more see.
    mean_m, worst_m: root mean square and largest standard deviation of X, Y, Z at the check points, m; empty
        when the flight does not determine them.
    camera_px: standard deviations of c, x0, y0, px; empty without self-calibration.
    reason: why there is no result; empty otherwise.
    """

    method: str
    images: int
    points: int
    rays: int
    check: int
    mean_m: tuple[float, ...] = ()
    worst_m: tuple[float, ...] = ()
    camera_px: dict[str, float] = field(default_factory=dict)
    reason: str = ""


def simulate(flight: PlannedFlight, layout: Layout, survey: PrecisionOptions) -> SimulatedPrecision:
    """Adjust a planned flight."""
    network, check = planned_network(flight, layout, survey)
    method = "indirect" if survey.gnss_m is None else "integrated"
    counts = (len(network.image_names), len(network.point_names), len(network.rays.image), len(check))
    if not len(check):
        return SimulatedPrecision(method, *counts, reason="no check point is seen by two photos")
    try:
        solution = adjust(network)
    except (IllPosedError, NotConvergedError) as refusal:
        return SimulatedPrecision(method, *counts, reason=str(refusal))
    variance = np.diagonal(solution.point_covariance[check], axis1=1, axis2=2)
    lens = np.sqrt(np.diag(solution.camera_covariance[0])) / flight.request.camera.pitch[0]
    camera_px = {name: float(lens[PARAMETERS.index(name)]) for name in ("c", "x0", "y0")}
    return SimulatedPrecision(
        method,
        *counts,
        tuple(np.sqrt(variance.mean(axis=0)).tolist()),
        tuple(np.sqrt(variance.max(axis=0)).tolist()),
        camera_px if survey.calibrate else {},
    )


def planned_network(
    flight: PlannedFlight, layout: Layout, survey: PrecisionOptions
) -> tuple[Network, Integers]:
    """Make the network that the flight will give, free of errors."""
    poses = _poses(flight)
    lens = flight.request.camera
    plane = np.vstack([*layout, _ties(flight)])
    # Waves of about a footprint's length: relief that every photo sees some of.
    length = min(flight.levels[0].footprint_m)
    height = survey.relief_m * np.sin(2 * np.pi * plane[:, 0] / length)
    height = height * np.cos(2 * np.pi * plane[:, 1] / length)
    xyz = np.column_stack([plane, height])
    if survey.calibrate:
        lens = replace(lens, estimated=among(*SELF_CALIBRATION))
    image, point, seen = visible_rays(poses, xyz, lens)
    keep = np.bincount(point)[point] >= 2
    # Photos at the ends of strips may see no ground of the area; four points orient a photo.
    strong = np.bincount(image[keep], minlength=len(poses)) >= 4
    keep &= strong[image]
    image, point, seen = image[keep], point[keep], seen[keep]
    keep = np.bincount(point)[point] >= 2
    image, point, seen = image[keep], point[keep], seen[keep]
    used, place = np.unique(point, return_inverse=True)
    number = np.cumsum(strong) - 1
    order = np.argsort(place, kind="stable")
    control = used < len(layout[0])
    sigma = np.full((len(used), 3), np.inf)
    sigma[control] = [survey.control_m[0]] * 2 + [survey.control_m[1]]
    held, weight = point_weights(sigma)
    images = int(strong.sum())
    pose_sigma = np.full((images, 6), np.inf)
    if survey.gnss_m is not None:
        pose_sigma[:, 3:] = [survey.gnss_m[0]] * 2 + [survey.gnss_m[1]]
    precision = np.full((len(order), 2), survey.image_sigma_px * lens.pitch[0])
    network = Network(
        (lens,),
        ExteriorOrientations(np.zeros(images, dtype=np.int64), poses[strong], pose_sigma),
        Points(xyz[used], held, weight),
        Rays(number[image][order], place[order], seen[order], precision),
        tuple(f"photo {k + 1}" for k in np.flatnonzero(strong)),
        tuple(f"point {k + 1}" for k in used),
    )
    last = len(layout[0]) + len(layout[1])
    return network, np.flatnonzero(~control & (used < last))


def _poses(flight: PlannedFlight) -> Floats:
    """Angles and places of the planned exposures, looking straight down, shape (n, 6)."""
    rows = []
    for strip in flight.strips:
        line = strip.exposures_m[-1] - strip.exposures_m[0]
        azimuth = float(np.arctan2(line[0], line[1]))
        kappa = -azimuth if flight.request.along == "rows" else np.pi / 2 - azimuth
        rows += [[0.0, 0.0, kappa, e, n, strip.height_m] for e, n in strip.exposures_m.tolist()]
    return np.array(rows)


def _ties(flight: PlannedFlight) -> Floats:
    """A net of tie points over all ground that the photos may show; those in one photo drop out later."""
    sides = [min(level.footprint_m) for level in flight.levels]
    reach = max(max(level.footprint_m) for level in flight.levels) / 2.0
    # Tie points per side of a footprint: 25 in each photo.
    ties_per_side = 5
    step = min(sides) / ties_per_side
    exposures = np.vstack([strip.exposures_m for strip in flight.strips])
    return grid(exposures.min(axis=0) - reach, exposures.max(axis=0) + reach, step)


def visible_rays(poses: Floats, xyz: Floats, planned: Camera) -> tuple[Integers, Integers, Floats]:
    """Which photo sees which point, and where from its middle, in the unit of the camera."""
    half = np.array(planned.size_px) / 2.0 * planned.pitch
    images, points, seen = [], [], []
    for number, pose in enumerate(poses):
        q = (xyz - pose[3:]) @ matrix_from_angles(pose[:3]).T
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = -planned.value("c") * q[:, :2] / q[:, 2:]
        visible = np.flatnonzero((np.abs(plane) < half).all(axis=1) & (q[:, 2] < 0))
        images.append(np.full(len(visible), number))
        points.append(visible)
        seen.append(plane[visible])
    return np.concatenate(images), np.concatenate(points), np.vstack(seen)


def to_json(result: SimulatedPrecision, survey: PrecisionOptions) -> dict[str, object]:
    """Give a simulated adjustment as a JSON value."""
    axes = ("x", "y", "z")
    given = {"self_calibration": "calibrate", "control_sigma_m": "control_m", "gnss_sigma_m": "gnss_m"}
    return {
        **picked(result, "method", "images", "points", "rays", check_points="check"),
        **picked(survey, "relief_m", "image_sigma_px", **given),
        "sigma_m": dict(zip(axes, result.mean_m, strict=False)) or None,
        "worst_sigma_m": dict(zip(axes, result.worst_m, strict=False)) or None,
        "camera_sigma_px": result.camera_px or None,
        "reason": result.reason or None,
    }


def to_text(result: SimulatedPrecision, say: Catalogue) -> str:
    """Write a simulated adjustment for people."""
    counts = {name: getattr(result, name) for name in ("images", "points", "rays")}
    head = say("planned.simulated", method=say(f"shown.{result.method}"), **counts)
    if result.reason:
        return f"{head}\n{say('planned.not_determined', reason=say.stored(result.reason))}"
    mean, worst = (say.row(part, ".3f") for part in (result.mean_m, result.worst_m))
    text = f"{head}\n{say('planned.sigma', n=result.check, mean=mean, worst=worst)}"
    if result.camera_px:
        cells = (f"{name} {say.row([sigma], '.2f')} px" for name, sigma in result.camera_px.items())
        text += say("planned.camera", figures=say("join.figures").join(cells))
    return text
