"""What the exposures of a run say about how well distance and principal distance can be told apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from photocal.geometry.rotation import matrix_from_angles
from photocal.report.run import Run

# Pairs of axes are compared for this many images at most; beyond, every k-th is taken.
IMAGES = 1000


@dataclass(frozen=True)
class NetworkShape:
    """Two figures of a network.

    Attributes
    ----------
    convergence_deg : float
        Largest angle between two optical axes.
    depth_spread : float
        Distances of the points along the axes: 95th less 5th percentile over the median.
    """

    convergence_deg: float
    depth_spread: float


def network_shape(run: Run, camera_id: str) -> NetworkShape | None:
    """Measure the exposures of one camera."""
    number = {image: i for i, image in enumerate(run.exposures.image)}
    place = {point: j for j, point in enumerate(run.points.point)}
    pairs = [
        (number[image], place[point])
        for image, point in zip(run.residuals.image, run.residuals.point, strict=True)
        if point in place and run.exposures.camera[number[image]] == camera_id
    ]
    if not pairs:
        return None
    image, point = np.array(pairs, dtype=np.int64).T
    # The third row of the rotation is the camera's backward axis in object space.
    axes = np.asarray(matrix_from_angles(np.radians(run.exposures.angles_deg)))[:, 2, :]
    depth = np.abs(
        np.einsum("ij,ij->i", axes[image], run.points.position_m[point] - run.exposures.position_m[image])
    )
    low, middle, high = np.percentile(depth, [5, 50, 95])
    own = axes[np.unique(image)]
    own = own[:: -(-len(own) // IMAGES)]
    return NetworkShape(_largest_angle(own), float((high - low) / middle))


def _largest_angle(axes: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arccos(np.clip((axes @ axes.T).min(), -1.0, 1.0))))
