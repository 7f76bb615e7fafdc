"""What may be wrong with measured image coordinates: a field of displacements for each suspicion."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.network import Network
from photocal.adjustment.state import State
from photocal.base.arrays import Flags, Floats, Integers
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.geometry.distortion import undistorted

PARTS = 3
# A third has at least so many images; what is left of a field beside the other unknowns, a share squared.
FEWEST_IMAGES, LEFT = 4, 1e-6
# Exposures are a flight when this share of the steps from one to the next has the usual length, this nearly.
REGULAR_SHARE = 0.6
REGULAR_SPACING = 0.3
# A change of the camera is looked for at so many places: between strips, else evenly through the flight.
PLACES = 7


@dataclass(frozen=True)
class RayField:
    """A systematic error of the image coordinates with one unknown amount.

    code, parameter: of the table; the term that is missing, or the first image after a change; else empty.
    made: gives its displacements; of millions of rays all fields at once take gigabytes.
    unit: of the amount, where it is not the camera's.
    most: the largest amount that nature makes.
    """

    code: str
    parameter: str
    camera: int
    made: Callable[[], Floats]
    unit: str = ""
    most: float = np.inf

    @property
    def displacement(self) -> Floats:
        """What must be added to the measured image plane coordinates for an amount of 1, shape (n, 2).

        Zero for rays of other cameras. It is a function of the computed coordinates: of the measured ones, a
        field that shrinks the image would shrink the errors of measurement, too, and explain something in
        every block.
        """
        return self.made()

    @property
    def name(self) -> str:
        """Code and parameter, "radial K3"; unique for a camera."""
        return f"{self.code} {self.parameter}".strip()


def order_of(time: Floats | None, images: Integers) -> Integers:
    """Order in which images of a camera were taken: by time where all are known, else as they are listed."""
    if time is None or not np.isfinite(time[images]).all():
        return images
    return np.asarray(images[np.argsort(time[images], kind="stable")])


def course(order: Integers, images: int) -> Floats:
    """From -1/2 for the first to 1/2 for the last image in an order; 0 for all others."""
    at = np.zeros(images)
    at[order] = np.linspace(-0.5, 0.5, len(order))
    return at


def change_of(values: Floats, plane: Floats, parameter: str) -> Floats:
    """Change of computed image coordinates, shape (n, 2), with c, x0 or y0, distortion left out."""
    if parameter == "c":
        return np.asarray((plane - values[1:3]) / values[0])
    return np.broadcast_to(np.eye(2)[PARAMETERS.index(parameter) - 1], plane.shape).copy()


def ray_fields(adjusted: AdjustedNetwork, near: str = "") -> tuple[RayField, ...]:
    """List what the model of each camera does not already estimate, at the computed image coordinates.

    near: an image about which the place of a change of the camera is looked for more finely.
    """
    network, state, computed = adjusted.network, adjusted.state, adjusted.computed
    camera_of_ray = network.exposures.camera[network.rays.image]
    listed = list[RayField]()
    for k, camera in enumerate(network.cameras):
        of_camera = (camera_of_ray == k)[:, None]
        if not of_camera.any():
            continue
        current = camera.with_values(state.cameras[k])
        listed += [
            RayField(code, term, k, partial(_of_term, current, computed, of_camera, code, term))
            for code, term in _missing(current)
        ]
        if not camera.rolling:
            listed += _rolling_shutter(adjusted, k)
        listed += _change_of_c(network, state, computed, k, near)
    return tuple(listed)


def _change_of_c(network: Network, state: State, computed: Floats, camera: int, near: str) -> list[RayField]:
    """Give c as a drift from the first image to the last, then as changes at places; none of few images."""
    exposures, image = network.exposures, network.rays.image
    order = order_of(exposures.time, np.flatnonzero(exposures.camera == camera))
    of_camera = exposures.camera[image] == camera
    change = change_of(state.cameras[camera], computed, "c") * of_camera[:, None]
    scaled = partial(_scaled, image, change)
    at = course(order, len(network.image_names))
    listed = []
    if len(order) >= PARTS * FEWEST_IMAGES:
        listed.append(RayField("c-drift", "", camera, partial(scaled, -at)))
    for first in places_of_change(network, order, near):
        side = np.where(at < at[order[first]], -0.5, 0.5)
        name = network.image_names[order[first]]
        listed.append(RayField("camera-change", name, camera, partial(scaled, -side)))
    return listed


def _scaled(image: Integers, change: Floats, of_image: Floats) -> Floats:
    """A change of image coordinates times an amount for each image."""
    return np.asarray(of_image[image][:, None] * change)


def places_of_change(network: Network, order: Integers, near: str = "") -> list[int]:
    """Places in an order of images before which a camera may have changed: between strips, else evenly.

    near: the image of such a place: all places about it, as far as halfway to the next ones.
    """
    count = len(order)
    if count < 2 * FEWEST_IMAGES:
        return []
    strip = np.full(len(network.image_names), -1)
    strip[network.positions.image] = network.positions.strip
    of = strip[order]
    first = np.flatnonzero((np.diff(of) != 0) & (of[1:] >= 0) & (of[:-1] >= 0)) + 1
    first = first[(first >= FEWEST_IMAGES) & (first <= count - FEWEST_IMAGES)]
    even = np.linspace(0, count, PLACES + 2).round().astype(np.int64)[1:-1]
    even = even[(even >= FEWEST_IMAGES) & (even <= count - FEWEST_IMAGES)]
    if len(first) > PLACES:
        first = first[np.linspace(0, len(first) - 1, PLACES).round().astype(np.int64)]
    coarse = np.unique(first if len(first) else even)
    if near not in network.image_names:
        return [int(place) for place in coarse]
    middle = int(np.flatnonzero(order == network.image_names.index(near))[0])
    # Once a place is found, so many on either side of it are tried.
    finely = 6
    reach = min(max(count // (2 * PLACES), 2), finely)
    fine = np.arange(max(middle - reach, FEWEST_IMAGES), min(middle + reach, count - FEWEST_IMAGES) + 1)
    return [int(place) for place in fine]


def _missing(camera: Camera) -> list[tuple[str, str]]:
    """Code and parameter of the terms that a camera does not estimate."""
    lens = camera.lens
    estimated = {name for name, is_so in zip(PARAMETERS, camera.estimated, strict=True) if is_so}
    scale_term, shear_term = ("B2", "B1") if camera.affinity_form == "tank" else ("B1", "B2")
    terms = [("y-scale", "")] * (scale_term not in estimated) + [("shear", "")] * (
        shear_term not in estimated
    )
    orders = (f"K{n}" for n in (1, 2, 3, 4) if f"K{n}" in lens.terms and f"K{n}" not in estimated)
    terms += [("radial", order) for order in islice(orders, 1)]
    return terms + [("decentring", n) for n in ("P1", "P2") if n in lens.terms and n not in estimated]


def _of_term(camera: Camera, plane: Floats, own: Flags, code: str, parameter: str) -> Floats:
    """Displacement by a unit of a term of a camera, of its own rays."""
    zero, lens = np.zeros(len(plane)), camera.lens
    if code in ("y-scale", "shear"):
        of_y = (zero, plane[:, 1]) if code == "y-scale" else (plane[:, 1], zero)
        return np.asarray(np.column_stack(of_y) * own)
    ideal = camera.model == "brown-ideal"
    x, y = (undistorted(camera, plane) if ideal else plane - camera.values[1:3]).T
    # Coefficients without unit: those of coordinates over c.
    scale = camera.value("c") if lens.relative else 1.0
    x, y = x / scale, y / scale
    r2 = x * x + y * y
    if code == "radial":
        order = int(parameter[1])
        power = order / 2 if camera.model == "pix4d-fisheye" else order
        at = np.column_stack([x, y]) * (r2**power)[:, None]
    elif parameter == "P1":
        at = np.column_stack([r2 + 2 * x * x, 2 * x * y])
    else:
        at = np.column_stack([2 * x * y, r2 + 2 * y * y])
    return np.asarray(scale * at * own)


def _rolling_shutter(adjusted: AdjustedNetwork, camera: int) -> list[RayField]:
    """Give minus the image motion while the rows are read: per second, or per exposure interval."""
    network = adjusted.network
    images = np.flatnonzero(network.exposures.camera == camera)
    if len(images) < FEWEST_IMAGES + 1:
        return []
    motion, unit = _velocity(network, adjusted.state, images)
    if motion is None:
        return []
    return [RayField("rolling-shutter", "", camera, partial(_while_read, adjusted, camera, motion), unit)]


def _while_read(adjusted: AdjustedNetwork, camera: int, motion: Floats) -> Floats:
    """Displacement by a unit of the readout of a camera whose images move."""
    network, state, q = adjusted.network, adjusted.state, adjusted.seen
    interior, image = network.cameras[camera], network.rays.image
    dq = -np.einsum("nij,nj->ni", state.rotation, motion)[image]
    c = state.cameras[camera, 0]
    dp = -c * (dq[:, :2] / q[:, 2:] - q[:, :2] * dq[:, 2:] / q[:, 2:] ** 2)
    # Rows are read from the top; the middle row is the reference.
    late = -adjusted.computed[:, 1] / (interior.size_px[1] * interior.pitch[1])
    own = (network.exposures.camera[image] == camera)[:, None]
    return np.asarray(-dp * late[:, None] * own)


def _velocity(network: Network, state: State, images: Integers) -> tuple[Floats | None, str]:
    """How the images of a camera fly, as recorded (m/s), else the way from one exposure to the next."""
    motion = np.zeros((len(network.image_names), 3))
    positions, given = network.positions, network.exposures.motion
    flown = positions.velocity.any(axis=1)
    motion[positions.image[flown]] = positions.velocity[flown]
    if not motion[images].any() and given is not None:
        motion[images] = np.nan_to_num(given[images, :3])
    if np.mean(motion[images].any(axis=1)) > REGULAR_SHARE:
        return motion, "s"
    velocity = _per_interval(state.centre[images])
    if velocity is None:
        return None, ""
    motion[images] = velocity
    return motion, "exposure intervals"


def _per_interval(centres: Floats) -> Floats | None:
    """Give the way flown per exposure interval, (n, 3); zero where a line has only one exposure."""
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
