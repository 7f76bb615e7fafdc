"""Cameras fixed to each other: relative orientations and times of the heads as common unknowns.

Head k of a rig has, at the exposure of its first head with rotation R and projection centre X,
R_k = S_k R  and  X_k = X + R' t_k + v d_k, with S_k = exp([r_k]x) N_k, N_k the nominal rotation from the axes
of the first head to its own, r_k a small turn about its own axes, t_k its projection centre in the axes of
the first head, and d_k the time by which it exposes later, while the rig flies with v and turns. Two images
a and b of one exposure relate these to their poses:  log(R_b R_a' exp(-[w]x d) S_a S_b')  and
S_a' R_a (X_b - X_a - v d) - (t_b - t_a), d = d_b - d_a, w the turn per second of what the camera of a sees.
None of them has to be the first head. The standard deviations are the stiffness of the frame, together with
what gusts move it by until the later one exposes: for the time that is known between the two.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from photocal.adjustment.equations import Equations
from photocal.adjustment.mounting import whitened
from photocal.base.arrays import Flags, Floats, Integers
from photocal.geometry.rotation import inverse_left_jacobian, left_jacobian, skew, turned

# What a head has: 3 turns (rad), 3 coordinates of its projection centre (m), 1 time (s).
TURN, CENTRE, LATER = slice(0, 3), slice(3, 6), 6
OF_HEAD = ("turn_x", "turn_y", "turn_z", "x", "y", "z", "time")


@dataclass(frozen=True)
class RigHeads:
    """The heads of all rigs of a network, and their images of the same exposures.

    rotation (heads, 3, 3): nominal rotation from the axes of the rig's first head to those of each.
    values, sigma (heads, 7): as `OF_HEAD`; a sigma of 0 holds a value, as all of a first head, a positive
        one weights it, infinity leaves it free.
    camera (heads,): camera of each head.
    base (heads,): the head that it refers to.
    first, second (pairs,): images of one exposure.
    stiffness (pairs, 2): how far the second image's head moves (m) and turns (rad) against the first one's.
    gust (pairs, 2): by how much velocity (m/s) and rate (rad/s) depart from what is known of the flight.
    lag (heads, 2): time by which each exposes later and its sigma, s, while which gusts move the frame.
    """

    rotation: Floats
    values: Floats
    sigma: Floats
    camera: Integers
    base: Integers
    first: Integers
    second: Integers
    stiffness: Floats
    gust: Floats
    lag: Floats

    def head_of(self, image_camera: Integers) -> Integers:
        """Head that took each image, shape (images,); -1 for a camera of its own."""
        head = np.full(max(image_camera.max(initial=-1), self.camera.max(initial=-1)) + 1, -1)
        head[self.camera] = np.arange(len(self.camera))
        return np.asarray(head[image_camera])

    def relation_sigma(self, image_camera: Integers) -> Floats:
        """Standard deviations of the relations, m and rad, shape (pairs, 2)."""
        head, later = self.head_of(image_camera), self.lag[:, 0]
        p, q = head[self.first], head[self.second]
        square = (later[q] - later[p]) ** 2 + self.lag[p, 1] ** 2 + self.lag[q, 1] ** 2
        return np.asarray(np.sqrt(self.stiffness**2 + self.gust**2 * square[:, None]))

    def unknown(self, image_camera: Integers) -> Flags:
        """Which values are unknowns, shape (heads, 7): those of heads that have partners."""
        head = self.head_of(image_camera)
        seen = np.zeros(len(self.camera), dtype=np.bool_)
        seen[head[np.concatenate([self.first, self.second])]] = True
        return np.asarray((self.sigma != 0) & seen[:, None])

    def of_images(self, place: Integers, kept: Flags) -> Self:
        """Rig of some images, at the places that these have now."""
        both = kept[self.first] & kept[self.second]
        return replace(
            self,
            first=place[self.first[both]],
            second=place[self.second[both]],
            stiffness=self.stiffness[both],
            gust=self.gust[both],
        )


_NONE, _NO_SIGMAS, _NO_VALUES = np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 7))
_NO_HEADS = np.zeros((0, 3, 3)), _NO_VALUES, _NO_VALUES, _NONE, _NONE
NO_RIG = RigHeads(*_NO_HEADS, _NONE, _NONE, _NO_SIGMAS, _NO_SIGMAS, _NO_SIGMAS)


def head_rotation(rig: RigHeads, values: Floats) -> Floats:
    """Rotations from the axes of the first head to those of each, shape (heads, 3, 3)."""
    return turned(rig.rotation, values[:, TURN])


def pairs_of(exposure: Integers, head: Integers, base: Integers) -> tuple[Integers, Integers]:
    """Pair the images of each exposure and rig: the lowest head that is there with each of the others.

    exposure (images,): -1 for an image of none; head (images,): -1 for a camera of no rig.
    """
    image = np.flatnonzero((exposure >= 0) & (head >= 0))
    image = image[np.lexsort((head[image], base[head[image]], exposure[image]))]
    key = np.column_stack([exposure[image], base[head[image]]])
    begins = np.ones(len(image), dtype=np.bool_)
    begins[1:] = (key[1:] != key[:-1]).any(axis=1)
    leader = image[begins][np.cumsum(begins) - 1] if len(image) else image
    return leader[~begins], image[~begins]


def rig_equations(
    rig: RigHeads,
    values: Floats,
    image_camera: Integers,
    poses: tuple[Floats, Floats],
    motion: Floats | None,
    image_columns: Integers,
    basis: Floats,
    columns: Integers,
) -> Equations:
    """Linearise the relations between images of one exposure.

    values (heads, 7); columns (heads, 7): of the unknowns of the heads, -1 for what is none.
    poses: rotations (images, 3, 3) from object to camera axes, and projection centres (images, 3), m.
    motion (images, 6 or 21): velocity and rate as `Exposures` has them; None at rest.
    """
    rotation, centre = poses
    a, b = rig.first, rig.second
    head = rig.head_of(image_camera)
    p, q = head[a], head[b]
    turn, to_head = values[:, TURN], head_rotation(rig, values)
    moving = np.zeros((len(a), 6)) if motion is None else motion[a]
    velocity, rate = moving[:, :3], moving[:, 3:6]
    later = (values[q, LATER] - values[p, LATER])[:, None]
    onward = turned(np.broadcast_to(np.eye(3), (len(a), 3, 3)), -rate * later)
    between = rotation[b] @ np.swapaxes(rotation[a], 1, 2)
    product = between @ onward @ to_head[p] @ np.swapaxes(to_head[q], 1, 2)
    residual = Rotation.from_matrix(product).as_rotvec() if len(a) else np.zeros((0, 3))
    inverse_left = inverse_left_jacobian(residual)
    inverse_right = np.swapaxes(inverse_left, 1, 2)
    jacobian = left_jacobian(turn)
    turning = [
        (image_columns[a, :3], -inverse_left @ between @ basis[a]),
        (image_columns[b, :3], inverse_left @ basis[b]),
        (columns[p, TURN], inverse_left @ between @ onward @ jacobian[p]),
        (columns[q, TURN], -inverse_right @ jacobian[q]),
        (columns[p, LATER:], (inverse_left @ between @ rate[:, :, None])),
        (columns[q, LATER:], -(inverse_left @ between @ rate[:, :, None])),
    ]
    to_first = np.swapaxes(to_head[p], 1, 2)
    to_body = to_first @ rotation[a]
    apart = centre[b] - centre[a] - velocity * later
    seen = np.einsum("nab,nb->na", rotation[a], apart)
    place = np.einsum("nab,nb->na", to_body, apart) - (values[q, CENTRE] - values[p, CENTRE])
    eye = np.broadcast_to(np.eye(3), (len(a), 3, 3))
    flown = to_body @ velocity[:, :, None]
    moved = [
        (image_columns[a, :3], -to_first @ skew(seen) @ basis[a]),
        (image_columns[a, 3:], -to_body),
        (image_columns[b, 3:], to_body),
        (columns[p, TURN], to_first @ skew(seen) @ jacobian[p]),
        (columns[p, CENTRE], eye),
        (columns[q, CENTRE], -eye),
        (columns[p, LATER:], flown),
        (columns[q, LATER:], -flown),
    ]
    sigma = rig.relation_sigma(image_camera)
    per_metre, per_radian = (np.eye(3) / sigma[:, k, None, None] for k in range(2))
    turns, places = whitened(turning, residual, per_radian), whitened(moved, place, per_metre)
    return Equations(
        np.concatenate([turns.start, turns.start[-1] + places.start[1:]]),
        *(np.concatenate(pair) for pair in zip(turns[1:], places[1:], strict=True)),
    )
