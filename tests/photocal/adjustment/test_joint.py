"""Cross-covariances of chosen unknowns against the inverse of the whole normal matrix."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.factored import factored
from photocal.adjustment.joint import joint_covariance
from photocal.adjustment.network import Network
from photocal.base.errors import ConfigurationError
from photocal.geometry.camera import PARAMETERS
from tests.photocal import networks, oracle

INF = np.inf
PLACE = {name: ("camera", n) for n, name in enumerate(PARAMETERS)}
POSE = {name: n for n, name in enumerate(("omega", "phi", "kappa", "X", "Y", "Z"))}
XYZ = {"X": 0, "Y": 1, "Z": 2}


def compare(network: Network, chosen: list[tuple[str, str]], expected: int, defect: int = 0) -> None:
    plain = oracle.adjust_densely(network, defect=defect)
    unknowns, joint = joint_covariance(factored(network, adjust(network).state), chosen)
    assert len(unknowns) == expected
    columns = []
    for one in unknowns:
        if one.kind == "camera":
            columns.append(plain.column["camera", 0, PARAMETERS.index(one.parameter)])
        elif one.kind == "image" and one.parameter in POSE:
            columns.append(plain.column["exposure", int(one.of[1:]), POSE[one.parameter]])
        elif one.kind == "image":
            columns.append(plain.column["deviation", int(one.of[1:]), PARAMETERS.index(one.parameter)])
        else:
            columns.append(plain.column["point", int(one.of[1:]), XYZ[one.parameter]])
    theirs = plain.covariance[np.ix_(columns, columns)]
    sigma = np.sqrt(np.diag(theirs))
    assert np.abs((joint - theirs) / np.outer(sigma, sigma)).max() < 2e-4


def test_images_cameras_and_points() -> None:
    own = networks.lens(photo_variant={"x0": 0.02})
    sigma = np.full((6, 6), INF)
    sigma[2] = [INF, INF, 0.0, INF, 0.01, INF]
    network = networks.observe(
        networks.convergent((own,)), np.random.default_rng(21), exposure_sigma=sigma, missing=0.2
    )
    chosen = [("image", "i1"), ("image", "i2"), ("camera", "main"), ("point", "p3"), ("point", "p7")]
    compare(network, chosen, 7 + 6 + 7 + 6)


def test_points_that_observations_relate() -> None:
    scene, rng = networks.convergent(images=5, points=14), np.random.default_rng(22)
    network = networks.related(
        networks.observe(scene, rng, point_sigma=0.01), scene, rng, [0, 1], np.array([0.001, 0.001])
    )
    compare(network, [("point", "p0"), ("point", "p2"), ("point", "p9"), ("image", "i0")], 15)


def test_inner_constraints() -> None:
    network = networks.observe(
        networks.convergent(images=5, points=14), np.random.default_rng(23), point_sigma=INF, disturb=1e-4
    )
    network = replace(network, datum_points=np.array([0, 2, 4, 6, 8, 10]))
    compare(network, [("point", "p2"), ("point", "p3"), ("image", "i4"), ("camera", "main")], 19, defect=7)


def test_a_name_that_is_none() -> None:
    network = networks.observe(networks.convergent(), np.random.default_rng(24))
    with pytest.raises(ConfigurationError, match="point p99 is not an unknown"):
        joint_covariance(factored(network, adjust(network).state), [("point", "p99")])
