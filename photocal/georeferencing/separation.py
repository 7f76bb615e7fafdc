"""What a flight cannot separate: values that could be freed together, and how well each would be known."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from photocal.adjustment.condensed import Condensed
from photocal.adjustment.mounting import BORESIGHT, COMMON, LEVER, SHIFT, TIME
from photocal.adjustment.readout import READOUT
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError
from photocal.block.model import Block
from photocal.geometry.camera import PARAMETERS, Camera

# What is asked of a calibration flight: 1 m, 1 degree, 0.1 s, 1 m; the camera: 1 % of c, 0.1 s of readout.
_SCALE_COMMON = np.array([1.0] * 3 + [np.radians(1.0)] * 3 + [0.1] + [1.0] * 3 + [0.0])
_SCALE_CAMERA, _SCALE_READOUT = 0.01, 0.1


@dataclass(frozen=True)
class Separation:
    """How well the flight determines the values that could be freed together.

    sigma (k,): standard deviation when all are free, in m, rad, s and the camera's unit; the prior of 1 m, 1
        degree, 0.1 s, 1 % of c is included.
    groups: names that are not separated from each other; a single name is not determined at all.
    """

    names: tuple[str, ...]
    sigma: Floats
    correlation: Floats
    groups: tuple[tuple[str, ...], ...]


def separation(block: Block, whole: Condensed) -> Separation | None:
    """See what the block would leave open if everything were free; None without positions.

    whole: equations of what its images share, with all of it free.
    """
    if not len(block.positions.image):
        return None
    asked = np.zeros(len(block.mounting.sigma), dtype=bool)
    asked[LEVER], asked[SHIFT] = True, True
    asked[BORESIGHT] = len(block.attitudes.image) > 0
    asked[TIME] = bool(np.any(block.positions.velocity))
    taken = np.flatnonzero(asked)
    sigma = np.zeros(len(asked))
    sigma[taken] = _SCALE_COMMON[taken]
    cameras = tuple(replace(camera, prior_sigma=_scales(camera)) for camera in block.cameras)
    columns = [int(whole.common_columns[k]) for k in taken]
    names = [COMMON[k] for k in taken]
    scale = [float(_SCALE_COMMON[k]) for k in taken]
    for camera, camera_columns in zip(cameras, whole.camera_columns, strict=True):
        for k, column in zip(*camera_columns, strict=True):
            if np.isfinite(camera.prior_sigma[k]):
                names.append(PARAMETERS[k] + (f"[{camera.id}]" if len(cameras) > 1 else ""))
                columns.append(int(column))
                scale.append(float(camera.prior_sigma[k]))
    try:
        mounting = replace(block.mounting, sigma=sigma)
        covariance = whole.covariance(cameras, mounting)[np.ix_(columns, columns)]
    except IllPosedError:
        return None
    deviation = np.sqrt(np.diag(covariance))
    groups = _groups(tuple(names), covariance / np.outer(scale, scale))
    return Separation(tuple(names), deviation, covariance / np.outer(deviation, deviation), groups)


def _scales(camera: Camera) -> Floats:
    """Scales of the estimated ones of c, x0, y0 and the readout; infinite of the others."""
    scale = np.full(len(PARAMETERS), np.inf)
    scale[:3], scale[READOUT] = _SCALE_CAMERA * camera.value("c"), _SCALE_READOUT
    return np.where(camera.estimated, scale, np.inf)


def _groups(names: tuple[str, ...], covariance: Floats) -> tuple[tuple[str, ...], ...]:
    """Names that the undetermined directions tie together."""
    # What has a smaller part in a direction without information has none in it.
    takes_part = 0.1
    variances, vectors = np.linalg.eigh(covariance)
    # A direction is not determined when its standard deviation stays above this share of the scale.
    undetermined = 0.05
    open_ = vectors[:, variances > undetermined**2]
    projector = open_ @ open_.T
    part = np.diag(projector) > takes_part
    linked = (np.abs(projector) > takes_part) & part[:, None] & part[None, :]
    _, label = connected_components(csr_array(linked), directed=False)
    groups: dict[int, list[str]] = {}
    for name, group, has in zip(names, label.tolist(), part.tolist(), strict=True):
        if has:
            groups.setdefault(group, []).append(name)
    return tuple(tuple(group) for group in groups.values())
