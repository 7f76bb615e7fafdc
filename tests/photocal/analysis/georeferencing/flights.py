"""Synthetic flights with known truth, projected by OpenCV and written as block folders."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]

WIDTH, HEIGHT, PITCH_MM, FOCAL_MM = 3000, 2000, 0.0045, 12.0
K1, K2, P1, P2 = -0.05, 0.02, 3e-4, -2e-4  # OpenCV's, of normalised coordinates
PRINCIPAL_PX = (8.0, -5.0)  # column, row from the middle
# North-east-down to east-north-up.
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# Body (forward, right, down) to a camera that looks down, upper edge forward: x right, y down, z forward.
BODY_TO_CV = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
CV_TO_PHOTO = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Errors:
    """What is wrong with the georeference that the block states as zero."""

    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    boresight_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    time_offset_s: float = 0.0
    datum_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    focal_mm: float = 0.0


@dataclass(frozen=True)
class Plan:
    """Flight and survey."""

    heights_m: tuple[float, float] = (90.0, 130.0)
    speeds_m_s: tuple[float, float] = (14.0, 8.0)
    pixel_sigma: float = 0.4
    position_sigma_m: float = 0.03
    attitude_sigma_deg: float = 0.03
    control_sigma_m: float = 0.015
    check_sigma_m: float = 0.010
    control: int = 9
    check: int = 20
    tie: int = 60
    relief_m: float = 8.0
    estimate: tuple[str, ...] = ()
    camera_sigma: dict[str, float] = field(default_factory=dict)
    mounting: str = ""


def fly(
    folder: Path, rng: np.random.Generator, errors: Errors | None = None, plan: Plan | None = None
) -> Path:
    """Write the block of a flight; every value that has a sigma got its random error."""
    errors, plan = errors or Errors(), plan or Plan()
    folder.mkdir(parents=True)
    xyz, roles = _ground(plan)
    rows = _exposures(plan)
    bore = Rotation.from_rotvec(np.radians(errors.boresight_deg)).as_matrix()
    images, positions, attitudes, seen = [], [], [], []
    # Camera values that carry a sigma are wrong by a random amount too.
    focal_true = FOCAL_MM + errors.focal_mm
    for name, (centre, angles, velocity, strip) in rows.items():
        body = Rotation.from_euler("ZYX", angles[::-1], degrees=True).as_matrix().T @ NED
        # The boresight turns the camera, given in photo axes (x right, y up, z backwards).
        photo = bore @ CV_TO_PHOTO @ BODY_TO_CV @ body
        pixels = _project(CV_TO_PHOTO @ photo, centre, xyz, focal_true)
        inside = (np.abs(pixels - [(WIDTH - 1) / 2, (HEIGHT - 1) / 2]) < [1480, 980]).all(axis=1)
        noisy = pixels + rng.normal(0.0, plan.pixel_sigma, pixels.shape)
        seen += [(name, f"p{j}", *noisy[j]) for j in np.flatnonzero(inside)]
        antenna = centre + body.T @ np.array(errors.lever_arm_m) - velocity * errors.time_offset_s
        antenna = antenna + np.array(errors.datum_m) + rng.normal(0.0, plan.position_sigma_m, 3)
        positions.append((name, *antenna, *[plan.position_sigma_m] * 3, *velocity, strip))
        turn = Rotation.from_rotvec(np.radians(rng.normal(0.0, plan.attitude_sigma_deg, 3))).as_matrix()
        read = Rotation.from_matrix((turn @ body @ NED.T).T).as_euler("ZYX", degrees=True)[::-1]
        attitudes.append((name, *read, *[plan.attitude_sigma_deg] * 3))
        start = CV_TO_PHOTO @ BODY_TO_CV @ turn @ body
        images.append((name, "cam", *antenna, *_opk(start)))
    points = []
    for j, (place, role) in enumerate(zip(xyz, roles, strict=True)):
        sigma = {"control": plan.control_sigma_m, "check": plan.check_sigma_m, "tie": 0.0}[role]
        shown = [f"{v:.5f}" for v in place + rng.normal(0.0, sigma or 0.5, 3)] if role != "tie" else [""] * 3
        points.append((f"p{j}", *shown, *([sigma] * 3 if sigma else [""] * 3), role))
    count = {f"p{j}": 0 for j in range(len(xyz))}
    for row in seen:
        count[row[1]] += 1
    _write(folder, "images.csv", "image,camera,X,Y,Z,omega,phi,kappa", images)
    _write(folder, "points.csv", "point,X,Y,Z,sX,sY,sZ,role", [p for p in points if count[p[0]] > 1])
    _write(folder, "observations.csv", "image,point,x,y", [s for s in seen if count[s[1]] > 1])
    _write(folder, "positions.csv", "image,X,Y,Z,sX,sY,sZ,vX,vY,vZ,strip", positions)
    _write(folder, "attitudes.csv", "image,roll,pitch,yaw,sroll,spitch,syaw", attitudes)
    (folder / "block.toml").write_text(_toml(plan, rng), encoding="utf-8")
    return folder


def _toml(plan: Plan, rng: np.random.Generator) -> str:
    f = FOCAL_MM
    # brown-ideal in mm: K of r^2 in mm^2, y up.
    true = {
        "c": f,
        "x0": PRINCIPAL_PX[0] * PITCH_MM,
        "y0": -PRINCIPAL_PX[1] * PITCH_MM,
        "K1": K1 / f**2,
        "K2": K2 / f**4,
        # OpenCV: dx = 2 p1 x y + p2 (r2 + 2 x^2), dy = p1 (r2 + 2 y^2) + 2 p2 x y, y down.
        "P1": P2 / f,
        "P2": -P1 / f,
    }
    given = {k: v + rng.normal(0.0, plan.camera_sigma.get(k, 0.0)) for k, v in true.items()}
    text = ", ".join(f"{k} = {v!r}" for k, v in ((k, float(v)) for k, v in given.items()))
    prior = ", ".join(f"{k} = {v!r}" for k, v in plan.camera_sigma.items())
    return f"""\
[block]
name = "flight"
frame = "local"
datum = "control"

[observations]
unit = "px"
axes = "pixel"
sigma = {plan.pixel_sigma}

[[camera]]
id = "cam"
model = "brown-ideal"
unit = "mm"
size_px = [{WIDTH}, {HEIGHT}]
pitch_mm = {PITCH_MM}
parameters = {{ {text} }}
estimate = {list(plan.estimate)}
prior_sigma = {{ {prior} }}

[mounting]
{plan.mounting}
"""


def _ground(plan: Plan) -> tuple[Floats, list[str]]:
    """Control spread to the corners, check points between, tie points everywhere: always the same."""
    rng = np.random.default_rng(5)
    side = math.ceil(math.sqrt(plan.control))
    grid = np.linspace(-85.0, 85.0, side)
    control = [(x, y * 0.8) for x in grid for y in grid][: plan.control]
    check = rng.uniform([-85.0, -65.0], [85.0, 65.0], (plan.check, 2))
    # Tie points reach beyond, so that the images at the ends of the strips see enough of them.
    tie = rng.uniform([-115.0, -95.0], [115.0, 95.0], (plan.tie, 2))
    plane = np.vstack([control, check, tie])
    z = plan.relief_m * np.sin(plane[:, 0] / 37.0) * np.cos(plane[:, 1] / 29.0)
    roles = ["control"] * len(control) + ["check"] * plan.check + ["tie"] * plan.tie
    return np.column_stack([plane, z]), roles


def _exposures(plan: Plan) -> dict[str, tuple[Floats, Floats, Floats, int]]:
    """Centre, roll pitch yaw (deg), velocity and strip of every exposure: always the same."""
    rng = np.random.default_rng(6)
    rows = {}
    lines: list[tuple[float, float, float, float, float]] = []
    for k, y in enumerate((-60.0, -20.0, 20.0, 60.0)):
        forward = k % 2 == 0
        lines.append((90.0 if forward else 270.0, y, plan.heights_m[0], plan.speeds_m_s[k % 2], 26.0))
    for k, x in enumerate((-50.0, 0.0, 50.0)):
        forward = k % 2 == 0
        lines.append((0.0 if forward else 180.0, x, plan.heights_m[1], plan.speeds_m_s[(k + 1) % 2], 36.0))
    for strip, (heading, offset, height, speed, base) in enumerate(lines):
        azimuth = math.radians(heading)
        along = np.array([math.sin(azimuth), math.cos(azimuth), 0.0])
        half = 78.0 if heading in (90.0, 270.0) else 54.0
        across = np.array([0.0, offset, 0.0]) if heading in (90.0, 270.0) else np.array([offset, 0.0, 0.0])
        for number, step in enumerate(np.arange(-half, half + 1.0, base)):
            centre = across + along * step + np.array([0.0, 0.0, height]) + rng.normal(0.0, 1.0, 3)
            angles = np.array([0.0, 0.0, heading]) + rng.normal(0.0, [3.0, 3.0, 4.0])
            rows[f"s{strip}_{number}"] = (centre, angles, along * speed + rng.normal(0.0, 0.3, 3), strip)
    return rows


def _project(to_camera: Floats, centre: Floats, xyz: Floats, focal_mm: float) -> Floats:
    f = focal_mm / PITCH_MM
    # Distortion belongs to the lens: K of mm stays the same when c changes.
    s = focal_mm / FOCAL_MM
    matrix = np.array(
        [
            [f, 0.0, (WIDTH - 1) / 2 + PRINCIPAL_PX[0]],
            [0.0, f, (HEIGHT - 1) / 2 + PRINCIPAL_PX[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    lens = np.array([K1 * s**2, K2 * s**4, P1 * s, P2 * s])
    turn, _ = cv2.Rodrigues(to_camera)
    pixels, _ = cv2.projectPoints(xyz, turn, -to_camera @ centre, matrix, lens)
    return np.asarray(pixels.reshape(-1, 2), dtype=np.float64)


def _opk(photo: Floats) -> tuple[float, float, float]:
    """Angles of M = R3(kappa) R2(phi) R1(omega), degrees: extrinsic x, y, z of the transposed matrix."""
    omega, phi, kappa = Rotation.from_matrix(photo.T).as_euler("XYZ", degrees=True)
    return float(omega), float(phi), float(kappa)


def _write(folder: Path, name: str, header: str, rows: list[tuple[object, ...]]) -> None:
    lines = [",".join(v if isinstance(v, str) else repr(float(v)) for v in row) for row in rows]  # type: ignore[arg-type]
    (folder / name).write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
