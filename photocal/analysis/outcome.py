"""The analysis of a network: everything that can be said of a calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from photocal.adjustment.network import Network
from photocal.analysis.camera_analysis import CameraAnalysis, analyse_camera
from photocal.analysis.method import METHODS, MethodCheck, Shape, check_method, shape
from photocal.analysis.systematic_errors.findings import findings
from photocal.analysis.systematic_errors.left_out import Checks
from photocal.analysis.systematic_errors.refit import fit
from photocal.analysis.systematic_errors.search import Search, search
from photocal.findings.finding import Finding


@dataclass(frozen=True)
class Outcome:
    """What the analysis of a network gives.

    findings: hidden errors, worst first.
    search: the figures behind them.
    cameras: one for each camera; None for those without estimated parameters.
    shape: geometry of the network.
    methods: each method with its requirements.
    alpha, threshold: level of the F tests, and correlation from which pairs are named.
    """

    findings: tuple[Finding, ...]
    search: Search
    cameras: tuple[CameraAnalysis | None, ...]
    shape: Shape
    methods: tuple[MethodCheck, ...]
    alpha: float
    threshold: float


def analyse_network(
    network: Network, checks: Checks, alpha: float, threshold: float, done: Callable[[], None] = lambda: None
) -> Outcome:
    """Adjust a network and analyse it.

    Raises
    ------
    IllPosedError, NotConvergedError
        As the adjustment does.
    """
    fitted = fit(network)
    searched = search(fitted, done)
    geometry = shape(network, fitted.state)
    return Outcome(
        findings(searched),
        searched,
        tuple(analyse_camera(fitted, k, checks, alpha, threshold, done) for k in range(len(network.cameras))),
        geometry,
        tuple(check_method(method, geometry) for method in METHODS),
        alpha,
        threshold,
    )
