"""What a flight cannot separate, whatever its errors: camera, readout, lever arm, boresight, time, datum."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from drivers.arrays import Floats
from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.adjust import adjust
from photocal.adjustment.covariance import blocks
from photocal.adjustment.envelope import factorise, selected_inverse
from photocal.adjustment.mounting import BORESIGHT, COMMON, LEVER, SHIFT, TIME
from photocal.adjustment.normal import normal_equations, prepare
from photocal.adjustment.readout import READOUT
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.geometry.camera import PARAMETERS, Camera

# What is asked of a calibration flight: 1 m, 1 degree, 0.1 s, 1 m; the camera: 1 % of c, 0.1 s of readout.
_SCALE_COMMON = np.array([1.0] * 3 + [np.radians(1.0)] * 3 + [0.1] + [1.0] * 3 + [0.0])
_SCALE_CAMERA, _SCALE_READOUT = 0.01, 0.1
# A direction is not determined when its standard deviation stays above this share of the scale.
_UNDETERMINED = 0.05
_TAKES_PART = 0.1


@dataclass(frozen=True)
class Separation:
    """How well the flight determines the values that could be freed together.

    sigma (k,): standard deviation when all are free, in m, rad, s and the camera's unit; the prior of 1 m, 1
        degree, 0.1 s, 1 % of c is included.
    correlation (k, k).
    groups: names that are not separated from each other; a single name is not determined at all.
    """

    names: tuple[str, ...]
    sigma: Floats
    correlation: Floats
    groups: tuple[tuple[str, ...], ...]


def separation(block: Block) -> Separation | None:
    """Free everything at once and see what the block leaves open."""
    if not len(block.positions.image):
        return None
    asked = np.zeros(len(block.mounting.sigma), dtype=bool)
    asked[LEVER], asked[SHIFT] = True, True
    asked[BORESIGHT] = len(block.attitudes.image) > 0
    asked[TIME] = bool(np.any(block.positions.velocity))
    taken = np.flatnonzero(asked)
    sigma = np.zeros(len(asked))
    sigma[taken] = _SCALE_COMMON[taken]
    cameras = tuple(replace(own, prior_sigma=_scales(own)) for own in block.cameras)
    network = assemble(replace(block, mounting=replace(block.mounting, sigma=sigma), cameras=cameras)).network
    try:
        state = adjust(network).state
    except (IllPosedError, NotConvergedError):
        return None
    problem = prepare(network)
    normal = normal_equations(problem, state)
    if factorise(problem.layout.envelope, normal.matrix) >= 0:
        return None
    inverse = selected_inverse(problem.layout.envelope, normal.matrix)
    columns = [problem.layout.common_columns[k] for k in taken]
    names = [COMMON[k] for k in taken]
    scale = [float(_SCALE_COMMON[k]) for k in taken]
    several = len(cameras) > 1
    for own, (active, at) in zip(cameras, problem.layout.camera_columns, strict=True):
        for k, column in zip(active, at, strict=True):
            if np.isfinite(own.prior_sigma[k]):
                names.append(PARAMETERS[k] + (f"[{own.id}]" if several else ""))
                columns.append(column)
                scale.append(float(own.prior_sigma[k]))
    covariance = blocks(np.array([columns]), problem.structure, inverse)[0]
    deviation = np.sqrt(np.diag(covariance))
    return Separation(
        tuple(names),
        deviation,
        covariance / np.outer(deviation, deviation),
        _groups(tuple(names), covariance / np.outer(scale, scale)),
    )


def _scales(own: Camera) -> Floats:
    """Scales of the estimated ones of c, x0, y0 and the readout; infinite of the others."""
    scale = np.full(len(PARAMETERS), np.inf)
    scale[:3], scale[READOUT] = _SCALE_CAMERA * own.value("c"), _SCALE_READOUT
    return np.where(own.estimated, scale, np.inf)


def _groups(names: tuple[str, ...], covariance: Floats) -> tuple[tuple[str, ...], ...]:
    """Names that the undetermined directions tie together."""
    variances, vectors = np.linalg.eigh(covariance)
    open_ = vectors[:, variances > _UNDETERMINED**2]
    projector = open_ @ open_.T
    part = np.diag(projector) > _TAKES_PART
    linked = (np.abs(projector) > _TAKES_PART) & part[:, None] & part[None, :]
    _, label = connected_components(csr_array(linked), directed=False)
    groups: dict[int, list[str]] = {}
    for name, group, has in zip(names, label.tolist(), part.tolist(), strict=True):
        if has:
            groups.setdefault(group, []).append(name)
    return tuple(tuple(group) for group in groups.values())
