"""Images whose orientation is known: the one class for them, whoever oriented them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.spatial.transform import Rotation

from photocal.base.arrays import Floats, Integers
from photocal.geometry.camera import SHAKE_DEGREES, Camera, pixel_to_plane, plane_to_pixel
from photocal.geometry.distortion import projected, undistorted
from photocal.geometry.frames import LocalFrame, nearest_rotation
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles


@dataclass(frozen=True, eq=False, repr=False)
class OrientedImages:
    """Images with their cameras and exterior orientation.

    Attributes
    ----------
    camera : array, shape (n,)
        Index into the cameras; -1 where it is not known.
    values : array, shape (n, 6)
        Omega, phi, kappa in radians, X, Y, Z of the projection centre in m; NaN where not known.
    covariance : array, shape (n, 6, 6)
        Of `values`; NaN for an image without one; None where no image has one.
    movement : array, shape (n, 6 or 21)
        While a rolling shutter reads an image: of the projection centre (m, axes of X, Y, Z) and turn of the
        camera (rad, its own axes), then the polynomials of its vibration, see `shutter`. `values` refer to
        the middle of the readout. None where no image moves.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    camera: Integers
    values: Floats
    covariance: Floats | None = None
    movement: Floats | None = None

    def __len__(self) -> int:
        return len(self.names)

    def __repr__(self) -> str:
        head = ("image", "X", "Y", "Z", "omega", "phi", "kappa")
        lines = [f"{len(self)} images (m, deg)", f"{head[0]:<20}" + "".join(f"{h:>13}" for h in head[1:])]
        for name, place, angles in zip(self.names[:8], self.station, self.angles_deg, strict=False):
            cells = [f"{v:>13.3f}" for v in place] + [f"{v:>13.4f}" for v in angles]
            lines.append(f"{name[:20]:<20}" + "".join(cells))
        return "\n".join(lines + ["..."] * (len(self) > 8))

    @cached_property
    def station(self) -> Floats:
        """Projection centres, m, shape (n, 3)."""
        return np.ascontiguousarray(self.values[:, 3:])

    @cached_property
    def rotation(self) -> Floats:
        """From object to camera axes, shape (n, 3, 3)."""
        return np.ascontiguousarray(matrix_from_angles(self.values[:, :3]))

    @property
    def angles_deg(self) -> Floats:
        """omega, phi, kappa, shape (n, 3)."""
        return np.degrees(self.values[:, :3])

    @property
    def covariances(self) -> Floats:
        """As `covariance`, also where there is none: NaN then."""
        return np.full((len(self), 6, 6), np.nan) if self.covariance is None else self.covariance

    @property
    def movements(self) -> Floats:
        """As `movement`, also where there is none: zero then."""
        return np.zeros((len(self), 6)) if self.movement is None else self.movement

    @cached_property
    def sigma(self) -> Floats:
        """Standard deviations of `values` (rad, m), shape (n, 6); NaN where not known."""
        return np.asarray(np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2)))

    def only(self, numbers: Sequence[int] | Integers) -> Self:
        """Give some of the images, in the order of their numbers."""
        chosen = np.asarray(numbers, dtype=np.int64)
        return replace(
            self,
            names=tuple(self.names[number] for number in chosen),
            camera=self.camera[chosen],
            values=self.values[chosen],
            covariance=None if self.covariance is None else self.covariance[chosen],
            movement=None if self.movement is None else self.movement[chosen],
        )

    def named(self, names: Sequence[str]) -> "OrientedImages":
        """Give images by their names, NaN and without a camera for those that are not there."""
        number = {name: k for k, name in enumerate(self.names)}
        rows = np.array([number.get(name, -1) for name in names], dtype=np.int64)
        lost = rows < 0
        padded = np.vstack([self.values, np.full(6, np.nan)])
        moved = None if self.movement is None else np.pad(self.movement, ((0, 1), (0, 0)))[rows]
        camera = np.where(lost, -1, np.r_[self.camera, -1][rows])
        return OrientedImages(tuple(names), self.cameras, camera, padded[rows], movement=moved)

    def in_local(self, frame: LocalFrame) -> Self:
        """Give the images in local coordinates, without covariance."""
        movement = None if self.movement is None else self.movement.copy()
        if movement is not None:
            turn = np.nan_to_num(frame.derivative(self.values[:, 3:]))
            movement[:, :3] = np.einsum("nab,nb->na", turn, movement[:, :3])
        return replace(self, values=local_poses(frame, self.values), covariance=None, movement=movement)

    def sizes(self) -> Floats:
        """Width and height of each image, px, shape (n, 2)."""
        return np.array([camera.size_px for camera in self.cameras], dtype=float)[self.camera]

    def project(self, image: Integers, xyz: Floats) -> Floats:
        """Columns and rows (px, shape (m, 2)) where images show points; NaN for those behind a camera.

        image (m,).
        xyz (m, 3).
        """
        # From a line's place to the pose and back: each time a hundredth of the change is left, or less.
        rounds = 6
        rotation, station = self.rotation[image], self.station[image]
        pixels = self._recorded(image, np.einsum("nij,nj->ni", rotation, xyz - station))
        # The line tells the pose, and the pose the line.
        for _ in range(0 if self.movement is None else rounds):
            rotation, station = self.at_lines(image, pixels)
            pixels = self._recorded(image, np.einsum("nij,nj->ni", rotation, xyz - station))
        return pixels

    def at_lines(self, image: Integers, pixels: Floats) -> tuple[Floats, Floats]:
        """Rotations, shape (m, 3, 3), and projection centres, (m, 3), while lines of images were read.

        image (m,).
        pixels (m, 2): whose rows, or columns, tell the line.
        """
        if self.movement is None:
            return self.rotation[image], self.station[image]
        late = self.late(image, pixels)[:, None]
        turn = Rotation.from_rotvec(turned(self.movement[image], late)).as_matrix()
        return turn @ self.rotation[image], self.station[image] + late * self.movement[image, :3]

    def late(self, image: Integers, pixels: Floats) -> Floats:
        """When lines of images were read, in readouts from the middle, shape (m,); as in `at_lines`."""
        slope = np.array([camera.line_slope() for camera in self.cameras])[self.camera[image]]
        pitch = np.array([camera.pitch for camera in self.cameras], dtype=float)[self.camera[image]]
        plane = pixel_to_plane(self.sizes()[image], pitch, np.nan_to_num(pixels))
        return np.asarray(np.clip((slope * plane).sum(axis=1), -1.0, 1.0))

    def at_the_middle(self, image: Integers, pixels: Floats) -> Floats:
        """Image coordinates reduced to the middle of the readout; shape (m, 2).

        image (m,).
        pixels (m, 2): where they do.
        """
        if self.movement is None:
            return pixels
        plane, c = self.ideal(image, pixels)
        upright = replace(self, values=np.zeros((len(self), 6)))
        turn, _ = upright.at_lines(image, pixels)
        seen = np.column_stack([plane, -c])
        return self._recorded(image, np.einsum("nba,nb->na", turn, seen))

    def _recorded(self, image: Integers, q: Floats) -> Floats:
        """Columns and rows where images record points of camera axes, shape (m, 2)."""
        pixels = np.full((len(image), 2), np.nan)
        for k, camera in enumerate(self.cameras):
            rows = np.flatnonzero(self.camera[image] == k)
            if len(rows):
                pixels[rows] = plane_to_pixel(camera.size_px, camera.pitch, projected(camera, q[rows]))
        return pixels

    def directions(self, places: Floats) -> Floats:
        """Directions in object space of rays through places of each image, shape (n, m, 3).

        places (m, 2): shares of the width and the height, from the upper left corner.
        """
        rays = []
        for camera in self.cameras:
            plane = pixel_to_plane(camera.size_px, camera.pitch, places * camera.size_px - 0.5)
            ideal = undistorted(camera, plane)
            rays.append(np.column_stack([ideal, np.full(len(ideal), -camera.values[0])]))
        return np.asarray(np.einsum("mkc,mcd->mkd", np.array(rays)[self.camera], self.rotation))

    def on_level(self, places: Floats, height: Floats | float) -> Floats:
        """Where rays through places of each image meet a level, shape (n, m, 3), in local coordinates.

        places: as of `directions`.
        height (n,): of the level, or one for all images.
        returns: NaN for an image of which a ray does not go there.
        """
        rays = self.directions(places)
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = (height - self.station[:, 2])[:, None] / rays[..., 2]
            points = self.station[:, None] + steps[..., None] * rays
        meet = np.asarray(((steps > 0) & np.isfinite(steps)).all(axis=1))
        return np.where(meet[:, None, None], points, np.nan)

    def ideal(self, image: Integers, pixels: Floats) -> tuple[Floats, Floats]:
        """Undistorted image coordinates from the principal point, shape (m, 2), and their c, shape (m,).

        image (m,).
        pixels (m, 2).
        """
        plane, c = np.empty((len(image), 2)), np.empty(len(image))
        for k, camera in enumerate(self.cameras):
            rows = np.flatnonzero(self.camera[image] == k)
            if len(rows):
                plane[rows] = undistorted(camera, pixel_to_plane(camera.size_px, camera.pitch, pixels[rows]))
                c[rows] = camera.value("c")
        return plane, c


def turned(movement: Floats, late: Floats) -> Floats:
    """Turns of cameras in lines beside those in the middle, rad, shape (m, 3).

    movement (m, 6 or 21): see `OrientedImages`.
    late (m, 1): in readouts from the middle.
    """
    turns = late * movement[:, 3:6]
    shakes = movement[:, 6:].reshape(len(turns), (movement.shape[1] - 6) // 3, 3)
    for degree, shake in zip(SHAKE_DEGREES, shakes.swapaxes(0, 1), strict=False):
        turns = turns + special.eval_legendre(degree, 2.0 * late) * shake
    return np.asarray(turns)


def oriented_images(
    cameras: Sequence[Camera], camera: ArrayLike, rotation: Floats, station: Floats
) -> OrientedImages:
    """Make oriented images, numbered, of rotation matrices (n, 3, 3) and projection centres (n, 3)."""
    values = np.hstack([angles_from_matrix(rotation), station])
    numbered = tuple(map(str, range(len(values))))
    return OrientedImages(numbered, tuple(cameras), np.asarray(camera, dtype=np.int64), values)


def local_poses(frame: LocalFrame, given: Floats) -> Floats:
    """Exterior orientations (n, 6) in local coordinates.

    Given angles refer to the given axes at each image.
    """
    return np.hstack([_turned(frame, given[:, :3], given[:, 3:], back=False), frame.to_local(given[:, 3:])])


def given_poses(frame: LocalFrame, local: Floats) -> Floats:
    """Exterior orientations (n, 6) in the given coordinates: the way back from `local_poses`."""
    place = given_places(frame, local[:, 3:])
    return np.hstack([_turned(frame, local[:, :3], place, back=True), place])


def given_places(frame: LocalFrame, local: Floats) -> Floats:
    """Points in the given coordinates, shape (n, 3); NaN where unknown."""
    known = np.isfinite(local).all(axis=1)
    given = np.full(local.shape, np.nan)
    if known.any():
        given[known] = frame.to_given(local[known])
    return given


def _turned(frame: LocalFrame, angles: Floats, places: Floats, *, back: bool) -> Floats:
    known = np.isfinite(angles).all(axis=1) & np.isfinite(places).all(axis=1)
    result = angles.copy()
    turn = nearest_rotation(frame.derivative(places[known])) if known.any() else np.eye(3)
    # A Cartesian frame keeps the very angles that were given.
    if (turn != np.eye(3)).any():
        turn = turn if back else np.swapaxes(turn, 1, 2)
        result[known] = angles_from_matrix(matrix_from_angles(angles[known]) @ turn)
    return result
