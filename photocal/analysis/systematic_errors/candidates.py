"""What may be wrong with measured image coordinates: one displacement field for each suspicion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from photocal.adjustment.network import Network
from photocal.adjustment.state import State
from photocal.analysis.systematic_errors.drift import FEWEST_IMAGES, PARTS, change_of, course, order_of
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.geometry.distortion import undistorted

# Exposures are a flight when this share of the steps from one to the next has the usual length, this nearly.
REGULAR_SHARE = 0.6
REGULAR_SPACING = 0.3
# A drift of c is held against steps at so many places.
STEPS = 7


@dataclass(frozen=True)
class Candidate:
    """A systematic error with one unknown amount.

    kind: "y-scale", "shear", "radial", "decentring", "rolling-shutter", "c-drift" or "c-step".
    parameter: the term of the camera model that is missing, or the first image after a step; else empty.
    camera: the camera concerned.
    displacement (n, 2): what must be added to the measured image plane coordinates for an amount of 1; zero
        for rays of other cameras. It is a function of the computed coordinates: of the measured ones, a field
        that shrinks the image would shrink the errors of measurement, too, and explain something in every
        block.
    """

    kind: str
    parameter: str
    camera: int
    displacement: Floats

    @property
    def name(self) -> str:
        """Kind and parameter, "radial K3"; unique for a camera."""
        return f"{self.kind} {self.parameter}".strip()


def candidates(network: Network, state: State, computed: Floats) -> tuple[Candidate, ...]:
    """List what the model of each camera does not already estimate, at the computed image coordinates."""
    camera_of_ray = network.exposures.camera[network.rays.image]
    found = []
    for k, camera in enumerate(network.cameras):
        mine = (camera_of_ray == k)[:, None]
        if not mine.any():
            continue
        current = camera.with_values(state.cameras[k])
        found += [
            Candidate(kind, term, k, field * mine) for kind, term, field in _of_camera(current, computed)
        ]
        motion = None if camera.rolling else _rolling_shutter(network, state, computed, k)
        if motion is not None:
            found.append(Candidate("rolling-shutter", "", k, motion * mine))
        found += _change_of_c(network, state, computed, k)[:1]
    return tuple(found)


def steps_of_c(network: Network, state: State, computed: Floats, camera: int) -> tuple[Candidate, ...]:
    """List steps of c at some places of the flight: what a drift must explain better than."""
    return _change_of_c(network, state, computed, camera)[1:]


def _change_of_c(network: Network, state: State, computed: Floats, camera: int) -> tuple[Candidate, ...]:
    """Give c as a drift from the first image to the last, then as steps; nothing for a few images."""
    exposures, image = network.exposures, network.rays.image
    order = order_of(exposures.time, np.flatnonzero(exposures.camera == camera))
    if len(order) < PARTS * FEWEST_IMAGES:
        return ()
    mine = exposures.camera[image] == camera
    change = change_of(state.cameras[camera], computed, "c") * mine[:, None]
    at = course(order, len(network.image_names))
    steps = np.unique(np.linspace(0, len(order), STEPS + 2).round().astype(int)[1:-1]).tolist()
    found = [Candidate("c-drift", "", camera, -at[image][:, None] * change)]
    for first in steps:
        side = np.where(at < at[order[first]], -0.5, 0.5)
        name = network.image_names[order[first]]
        found.append(Candidate("c-step", name, camera, -side[image][:, None] * change))
    return tuple(found)


def _of_camera(camera: Camera, plane: Floats) -> list[tuple[str, str, Floats]]:
    zero = np.zeros(len(plane))
    ideal, lens = camera.model == "brown-ideal", camera.lens
    x, y = (undistorted(camera, plane) if ideal else plane - camera.values[1:3]).T
    # Coefficients without unit: those of coordinates over c.
    scale = camera.value("c") if lens.relative else 1.0
    x, y = x / scale, y / scale
    estimated = {name for name, is_so in zip(PARAMETERS, camera.estimated, strict=True) if is_so}
    scale_term, shear_term = ("B2", "B1") if camera.affinity_form == "tank" else ("B1", "B2")
    found = []
    if scale_term not in estimated:
        found.append(("y-scale", "", np.column_stack([zero, plane[:, 1]])))
    if shear_term not in estimated:
        found.append(("shear", "", np.column_stack([plane[:, 1], zero])))
    r2 = x * x + y * y
    orders = (n for n in (1, 2, 3, 4) if f"K{n}" in lens.terms and f"K{n}" not in estimated)
    if (order := next(orders, None)) is not None:
        power = order / 2 if camera.model == "pix4d-fisheye" else order
        found.append(("radial", f"K{order}", scale * np.column_stack([x, y]) * (r2**power)[:, None]))
    if "P1" in lens.terms and "P1" not in estimated:
        found.append(("decentring", "P1", scale * np.column_stack([r2 + 2 * x * x, 2 * x * y])))
    if "P2" in lens.terms and "P2" not in estimated:
        found.append(("decentring", "P2", scale * np.column_stack([2 * x * y, r2 + 2 * y * y])))
    return found


def _rolling_shutter(network: Network, state: State, computed: Floats, camera: int) -> Floats | None:
    """Give minus the image motion while the rows are read, for a readout as long as the exposure interval.

    Only for exposures that follow one another at regular distances, in the order of the images: then
    the distance to the next one stands for the velocity.
    """
    mine = np.flatnonzero(network.exposures.camera == camera)
    if len(mine) < 5:
        return None
    velocity = _per_interval(state.centre[mine])
    if velocity is None:
        return None
    own = network.cameras[camera]
    motion = np.zeros((len(network.image_names), 3))
    motion[mine] = velocity
    image = network.rays.image
    q = np.einsum("nij,nj->ni", state.rotation[image], state.points[network.rays.point] - state.centre[image])
    dq = -np.einsum("nij,nj->ni", state.rotation[image], motion[image])
    c = state.cameras[camera, 0]
    dp = -c * (dq[:, :2] / q[:, 2:] - q[:, :2] * dq[:, 2:] / q[:, 2:] ** 2)
    # Rows are read from the top; the middle row is the reference.
    late = -computed[:, 1] / (own.size_px[1] * own.pitch[1])
    return np.asarray(-dp * late[:, None])


def _per_interval(centres: Floats) -> Floats | None:
    """Give the way flown per exposure interval, (n, 3); zero where a line has only one exposure.

    A step that is much longer or shorter than the usual one is a turn between lines, not flight.
    """
    steps = np.diff(centres, axis=0)
    length = np.linalg.norm(steps, axis=1)
    typical = float(np.median(length))
    regular = np.abs(length - typical) <= REGULAR_SPACING * typical
    if typical <= 0.0 or np.mean(regular) < REGULAR_SHARE:
        return None
    sums, count = np.zeros_like(centres), np.zeros(len(centres))
    for ends in (slice(None, -1), slice(1, None)):
        sums[ends] += steps * regular[:, None]
        count[ends] += regular
    return np.asarray(sums / np.maximum(count, 1.0)[:, None])
