"""SXB: five aerial images over Strasbourg, against DBAT's printed results."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.block.model import Block
from photocal.exchange.formats import read_foreign_block
from photocal.exchange.photomodeler import block_from_export, read_control, read_export
from tests.photocal.blocks import with_positions

pytestmark = pytest.mark.shared

KEYS = ("Omega", "Phi", "Kappa", "Xc", "Yc", "Zc")


@pytest.fixture
def folder(shared: Path) -> Path:
    return shared / "data" / "dbat-sxb"


def same_as_printed(
    block: Block,
    report: Any,
    adjusted: Any,
    origin: Any = (0, 0, 0),
    label: Callable[[str], str] = str,
    stopped_short: bool = False,
) -> None:
    found, solution = adjusted(block)
    assert solution.degrees_of_freedom == report.redundancy
    assert solution.observations == report.observations
    assert solution.unknowns == report.unknowns
    sigma0 = math.sqrt(solution.variance_factor)
    # DBAT stops when a step is shorter than its tolerance times the length of the residuals: in the flattest
    # direction that is up to this many standard deviations short of the minimum. Four of its runs show it.
    short = report.tolerance * report.last_error / sigma0 if stopped_short else 0.0
    assert abs(sigma0 - report.sigma0.value) <= 2 * report.sigma0.unit
    assert set(report.photos) == set(block.images.names)
    for k, name in enumerate(block.images.names):
        pose = found.images.values[k] - np.concatenate([np.zeros(3), np.asarray(origin)])
        pose[:3] = np.degrees(pose[:3])
        # DBAT's standard deviations are a posteriori.
        deviation = found.images.sigma[k] * sigma0
        deviation[:3] = np.degrees(deviation[:3])
        for value, sd, key in zip(pose, deviation, KEYS, strict=True):
            printed, printed_sd = report.photos[name][key]
            assert abs(value - printed.value) <= 2 * printed.unit + short * sd, (name, key)
            assert abs(sd - printed_sd.value) <= 2 * printed_sd.third_digit, (name, key)
    position = {name: k for k, name in enumerate(found.points.names)}
    count = np.bincount(found.observations.point)
    assert len(report.control) == block.points.of_role("control").sum()
    assert len(report.checks) == block.points.of_role("check").sum()
    for name, printed_point in (report.control | report.checks).items():
        k = position[label(name)]
        xyz = found.points.values[k] - np.asarray(origin)
        sigma = found.points.sigma[k] * sigma0
        assert count[k] == printed_point[6].value
        for value, cell in zip(xyz, printed_point[:3], strict=True):
            assert abs(value - cell.value) <= 2 * cell.unit, name
        for value, cell in zip(sigma, printed_point[3:6], strict=True):
            assert abs(value - cell.value) <= 2 * cell.third_digit, name


def test_set_up_with_check_points(folder: Path, dbat_report: Any, adjusted: Any) -> None:
    block = read_foreign_block(folder / "script" / "sxb.xml")
    assert block.points.of_role("check").sum() == 2
    assert block.points.of_role("control").sum() == 14
    report = dbat_report(folder / "script" / "report.txt")
    assert report.redundancy == 1261
    same_as_printed(block, report, adjusted)


@pytest.mark.parametrize(("prior", "redundancy"), [("no-prior-eo", 1267), ("prior-eo", 1279)])
def test_positions_as_observations(
    folder: Path, prior: str, redundancy: int, dbat_report: Any, adjusted: Any
) -> None:
    export = read_export(folder / "pmexports" / "wsmart-with-orient-pmexport.txt")
    control = read_control(folder / "ref" / "ctrlpts-weighted.txt")
    block = block_from_export(export, control)
    if prior == "prior-eo":
        block = with_positions(block, folder / "ref" / "fake-camera-positions.txt")
    report = dbat_report(folder / "dbatreports" / f"sxb-{prior}-dbatreport.txt")
    assert report.redundancy == redundancy
    same_as_printed(block, report, adjusted, stopped_short=prior == "prior-eo")


def test_the_minimum_does_not_depend_on_the_start(folder: Path, adjusted: Any) -> None:
    """In the weakest direction of this block, the flight line, a step too few is tens of micrometres."""
    export = read_export(folder / "pmexports" / "wsmart-with-orient-pmexport.txt")
    block = block_from_export(export, read_control(folder / "ref" / "ctrlpts-weighted.txt"))
    found, _ = adjusted(block)
    rng = np.random.default_rng(5)
    for spread in (1e-3, 0.5):
        values = block.images.values.copy()
        values[:, 3:] += rng.normal(0, spread, (len(values), 3))
        other, _ = adjusted(replace(block, images=replace(block.images, values=values)))
        assert np.abs((other.images.values - found.images.values) / found.images.sigma).max() < 1e-6


def test_photoscan_project(folder: Path, dbat_report: Any, adjusted: Any) -> None:
    """The larger set of tie points, straight from the PhotoScan project."""
    block = read_foreign_block(folder / "psprojects" / "sxb.psz")
    report = dbat_report(folder / "dbatreports" / "sxb-dbatreport.txt")
    assert report.observations == 8180
    # DBAT numbers the markers from 1 in the order of the project.
    markers = [name for name in block.points.names if not name.startswith("tie")]
    same_as_printed(block, report, adjusted, label=lambda number: markers[int(number) - 1])


@pytest.mark.parametrize(
    ("stem", "control"),
    [("f-op0", "fixed"), ("w-op0", "weighted"), ("w-op1", "weighted"), ("wsmart", "weighted")],
)
def test_fixed_and_weighted_control(
    folder: Path, stem: str, control: str, dbat_report: Any, adjusted: Any
) -> None:
    export = read_export(folder / "pmexports" / f"{stem}-with-orient-pmexport.txt")
    table = read_control(folder / "ref" / f"ctrlpts-{control}.txt")
    block = block_from_export(export, table)
    # These runs were made in PhotoModeler's own frame: control moved by the mean difference.
    shift = np.mean([table[name][0] - xyz for name, xyz in export.control.items()], axis=0)
    report = dbat_report(folder / "dbatreports" / f"{stem}-with-orient-dbatreport.txt")
    same_as_printed(block, report, adjusted, origin=shift, stopped_short=stem != "wsmart")
