"""The analysis of a network: everything that can be said of a calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from photocal.adjustment.network import Network
from photocal.analysis.camera_analysis import CameraAnalysis, analyse_camera
from photocal.analysis.method import METHODS, MethodCheck, Shape, check_method, shape
from photocal.analysis.robust import Robust, bootstrap, sandwich
from photocal.analysis.systematic_errors.camera_findings import of_datum
from photocal.analysis.systematic_errors.findings import findings
from photocal.analysis.systematic_errors.left_out import Checks
from photocal.analysis.systematic_errors.refit import fit
from photocal.analysis.systematic_errors.search import Search, search
from photocal.findings.finding import Finding

# Of the bootstrap: the same images are drawn again when a certificate is verified.
SEED = 1


@dataclass(frozen=True)
class Outcome:
    """What the analysis of a network gives.

    findings: hidden errors, worst first.
    search: the figures behind them.
    cameras: one for each camera; None for those without estimated parameters.
    shape: geometry of the network.
    methods: each method with its requirements.
    robust: second opinions on the precision of the cameras.
    alpha, threshold: level of the F tests, and correlation from which pairs are named.
    """

    findings: tuple[Finding, ...]
    search: Search
    cameras: tuple[CameraAnalysis | None, ...]
    shape: Shape
    methods: tuple[MethodCheck, ...]
    robust: Robust
    alpha: float
    threshold: float


def analyse_network(
    network: Network,
    checks: Checks,
    alpha: float,
    threshold: float,
    done: Callable[[], None] = lambda: None,
    draws: int = 0,
) -> Outcome:
    """Adjust a network and analyse it.

    Parameters
    ----------
    draws : int
        Of the bootstrap over images: as many more adjustments.

    Raises
    ------
    IllPosedError, NotConvergedError
        As the adjustment does.
    """
    fitted = fit(network)
    searched = search(fitted, done)
    geometry = shape(network, fitted.state)
    drawn = bootstrap(fitted, draws, np.random.default_rng(SEED), done) if draws else None
    return Outcome(
        (*findings(searched), *of_datum(searched)),
        searched,
        tuple(analyse_camera(fitted, k, checks, alpha, threshold, done) for k in range(len(network.cameras))),
        geometry,
        tuple(check_method(method, geometry) for method in METHODS),
        Robust(sandwich(fitted), drawn, draws),
        alpha,
        threshold,
    )
