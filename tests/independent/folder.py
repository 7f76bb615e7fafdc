"""A flight as a block folder, in the documented format."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.independent.flights import (
    ATTITUDE_DEG,
    BORESIGHT_DEG,
    BORESIGHT_SIGMA_DEG,
    CHECK_M,
    CONTROL_M,
    GNSS_M,
    Design,
    Errors,
    Observed,
    World,
    start_angles,
)
from tests.independent.optics import SIZE, Floats

# What a person knows of c beforehand: it is started with so much too long.
START_C = 1.004


@dataclass(frozen=True)
class Placement:
    """The same flight otherwise: turned (deg, counter-clockwise), moved (m), renamed, by two cameras.

    frame: a map system; coordinates of a tangent plane at `origin` (longitude, latitude) become its own.
    """

    turn_deg: float = 0.0
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    prefix: str = ""
    cameras: int = 1
    frame: str = "local"
    origin: tuple[float, float] = (0.0, 0.0)

    @property
    def turn(self) -> Floats:
        """Rotation of all coordinates, (3, 3)."""
        angle = np.radians(self.turn_deg)
        cos, sin = np.cos(angle), np.sin(angle)
        return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])

    def placed(self, places: Floats) -> Floats:
        """Coordinates in the other frame."""
        turned = np.asarray(places @ self.turn.T + self.shift_m)
        if self.frame == "local":
            return turned
        from pyproj import CRS, Transformer

        # PROJ's own tangent plane, by way of geocentric coordinates.
        longitude, latitude = self.origin
        ellipsoid = f"+ellps=GRS80 +lon_0={longitude} +lat_0={latitude} +h_0=0"
        map_system = CRS(self.frame)
        to_degrees = Transformer.from_pipeline(
            f"+proj=pipeline +step +inv +proj=topocentric {ellipsoid} +step +inv +proj=cart +ellps=GRS80"
        )
        degrees = np.column_stack(to_degrees.transform(*turned.T))
        to_map = Transformer.from_crs(map_system.geodetic_crs, map_system, always_xy=True)
        return np.column_stack([*to_map.transform(*degrees[:, :2].T), degrees[:, 2]])

    def image_names(self, truth: World) -> list[str]:
        """Names of the exposures."""
        return [f"{self.prefix}IMG_{k:04d}" for k in range(len(truth.centre))]

    def point_names(self, truth: World) -> list[str]:
        """Names of the points: co0, ch6, ti18 ..."""
        return [f"{self.prefix}{role[:2]}{j}" for j, role in enumerate(truth.role)]


def write_folder(
    folder: Path,
    design: Design,
    errors: Errors,
    truth: World,
    observed: Observed,
    at: Placement = Placement(),
) -> Path:
    """Write block.toml and the tables; a block that states nothing of the errors."""
    folder.mkdir(parents=True)
    turn, placed = at.turn, at.placed
    angles = observed.angles - [0.0, 0.0, np.radians(at.turn_deg)]
    observed = Observed(observed.pixels, placed(observed.antenna), angles, placed(observed.surveyed))
    images, points = at.image_names(truth), at.point_names(truth)
    seen = np.bincount(truth.point, minlength=len(points)) > 0
    camera = [f"cam{k % at.cameras}" for k in range(len(images))]
    start = np.degrees(start_angles(observed))
    _write(
        folder / "images.csv",
        "image,camera,X,Y,Z,omega,phi,kappa,time_s",
        zip(images, camera, *observed.antenna.T, *start.T, truth.time, strict=True),
    )
    rows = []
    for j in np.flatnonzero(seen):
        sigma = {"control": CONTROL_M, "check": CHECK_M, "tie": ("",) * 3}[truth.role[j]]
        place = ("",) * 3 if truth.role[j] == "tie" else tuple(observed.surveyed[j])
        rows.append((points[j], *place, *sigma, truth.role[j]))
    _write(folder / "points.csv", "point,X,Y,Z,sX,sY,sZ,role", rows)
    names = ((images[i], points[j]) for i, j in zip(truth.image, truth.point, strict=True))
    _write(
        folder / "observations.csv",
        "image,point,x,y",
        ((*pair, *xy) for pair, xy in zip(names, observed.pixels, strict=True)),
    )
    if design.gnss:
        stated = (np.array(GNSS_M) * np.ones((len(images), 1))).T
        velocity = (truth.velocity @ turn.T).T
        strip = [f"s{k}" for k in truth.strip]
        _write(
            folder / "positions.csv",
            "image,X,Y,Z,sX,sY,sZ,vX,vY,vZ,strip,time_s",
            zip(images, *observed.antenna.T, *stated, *velocity, strip, truth.time, strict=True),
        )
        attitude = (np.degrees(observed.angles) + 180.0) % 360.0 - 180.0
        _write(
            folder / "attitudes.csv",
            "image,roll,pitch,yaw,sroll,spitch,syaw",
            zip(images, *attitude.T, *np.full((3, len(images)), ATTITUDE_DEG), strict=True),
        )
    (folder / "block.toml").write_text(_toml(design, errors, truth, at), encoding="utf-8")
    return folder


def _toml(design: Design, errors: Errors, truth: World, at: Placement) -> str:
    held = {
        name: getattr(truth.lens, name) for name in ("x0", "y0", "K1", "K2") if name not in design.estimate
    }
    c = truth.lens.c * (1.0 + errors.c_stated if "c" not in design.estimate else START_C)
    parameters = ", ".join(f"{name} = {value!r}" for name, value in {"c": c, **held}.items())
    estimate = [*design.estimate]
    camera = f"""
model = "brown-ideal"
unit = "px"
size_px = [{SIZE[0]}, {SIZE[1]}]
parameters = {{ {parameters} }}
estimate = {estimate}
shutter = "{design.shutter}"
"""
    cameras = "".join(f'\n[[camera]]\nid = "cam{k}"{camera}' for k in range(at.cameras))
    text = f"""[block]
name = "{design.name}"
frame = "{at.frame}"
{'height = "ellipsoidal"' if at.frame != "local" else ""}
datum = "control"

[observations]
unit = "px"
axes = "pixel"
sigma = {design.sigma_px}
{cameras}"""
    if not design.gnss:
        return text
    stated = {
        "free": ((0.0, 0.0, 0.0), '"free"'),
        "stated": (BORESIGHT_DEG, str(BORESIGHT_SIGMA_DEG)),
        "held": (BORESIGHT_DEG, "0.0"),
    }
    boresight, sigma = stated[design.boresight]
    return f"""{text}
[mounting]
lever_arm_m = {list(errors.stated_lever_m)}
boresight_deg = {list(boresight)}
boresight_sigma_deg = {sigma}
"""


def _write(path: Path, header: str, rows: Iterable[tuple[object, ...]]) -> None:
    """Write a table; numbers with all their digits."""
    cells = (",".join(v if isinstance(v, str) else repr(float(v)) for v in row) for row in rows)  # type: ignore[arg-type]
    path.write_text("\n".join([header, *cells]) + "\n", encoding="utf-8")
