"""What the exposures of a run say about how well distance and principal distance can be told apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from photocal.report.stored_analysis import Run

# Pairs of axes are compared for this many images at most; beyond, every k-th is taken.
IMAGES = 1000


@dataclass(frozen=True)
class NetworkShape:
    """Two figures of a network.

    convergence_deg: largest angle between two optical axes.
    depth_spread: distances of the points along the axes: 95th less 5th percentile over the median.
    """

    convergence_deg: float
    depth_spread: float


def network_shape(run: Run, camera_id: str) -> NetworkShape | None:
    """Measure the exposures of one camera."""
    result, rays = run.result, run.result.residuals_of(camera_id)
    place = {name: j for j, name in enumerate(result.points.names)}
    point = np.array([place.get(name, -1) for name in rays.point_names], dtype=np.int64)[rays.point]
    image, point = rays.image[point >= 0], point[point >= 0]
    if not len(image):
        return None
    # The third row of the rotation is the camera's backward axis in object space.
    axes = result.images.rotation[:, 2, :]
    depth = np.abs(
        np.einsum("ij,ij->i", axes[image], result.points.values[point] - result.images.station[image])
    )
    low, middle, high = np.percentile(depth, [5, 50, 95])
    own = axes[np.unique(image)]
    own = own[:: -(-len(own) // IMAGES)]
    return NetworkShape(_largest_angle(own), float((high - low) / middle))


def _largest_angle(axes: Floats) -> float:
    return float(np.degrees(np.arccos(np.clip((axes @ axes.T).min(), -1.0, 1.0))))
