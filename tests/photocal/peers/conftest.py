"""Reading the peers' reports, so that every expected value comes from the peer's own words."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.solution import Solution
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.block.results.adjusted import result_of
from photocal.block.results.adjusted_block import adjusted_block
from photocal.block.results.folder import read_result, write_result


@dataclass
class Printed:
    """A number as printed: its value and the unit of its last digit."""

    text: str

    @property
    def value(self) -> float:
        return float(self.text)

    @property
    def unit(self) -> float:
        mantissa, _, exponent = self.text.lower().partition("e")
        return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))

    @property
    def third_digit(self) -> float:
        """Unit of the third significant digit: standard deviations are printed so, without final zeros."""
        return 10.0 ** (math.floor(math.log10(self.value)) - 2) if self.value else 1e-12


@dataclass
class DbatReport:
    """What a DBAT report says."""

    sigma0: Printed
    redundancy: int
    observations: int
    unknowns: int
    status: str
    tolerance: float
    last_error: float
    cameras: dict[str, tuple[Printed, Printed | None]] = field(default_factory=dict)
    correlations: dict[tuple[str, str], Printed] = field(default_factory=dict)
    photos: dict[str, dict[str, tuple[Printed, Printed]]] = field(default_factory=dict)
    # X, Y, Z, their standard deviations, and the number of rays, after the adjustment.
    control: dict[str, list[Printed]] = field(default_factory=dict)
    checks: dict[str, list[Printed]] = field(default_factory=dict)


_CAMERA_KEYS = {
    "Camera Constant": "cc",
    "px - principal point x": "px",
    "py - principal point y": "py",
    "as - off-unit aspect parameter": "as",
    "sk - skew": "sk",
}


def _find(pattern: str, text: str) -> str:
    found = re.search(pattern, text)
    assert found, pattern
    return found.group(1).strip()


def _points(text: str, title: str) -> dict[str, list[Printed]]:
    table = text.partition(title)[2].partition("Posterior\n")[2].partition("Diff (")[0]
    rows = ([cell.strip() for cell in line.split(",")] for line in table.splitlines()[1:])
    return {cells[0]: [Printed(cell) for cell in cells[1:8]] for cells in rows if len(cells) >= 8}


def read_dbat_report(path: Path) -> DbatReport:
    text = path.read_text(encoding="utf-8")
    report = DbatReport(
        Printed(_find(r"Sigma0:\s+(\S+)", text)),
        int(_find(r"Redundancy\s+(\d+)", text)),
        int(_find(r"Number of observations: (\d+)", text)),
        int(_find(r"Number of params:\s+(\d+)", text)),
        _find(r"Status:\s+(.+)", text),
        float(_find(r"Convergence tolerance:\s+(\S+)", text)),
        float(_find(r"Last error:\s+(\S+)", text)),
    )
    photo, key = None, ""
    value: Printed | None = None
    for line in text.partition("Quality\n")[0].splitlines():
        words = line.strip()
        if found := re.match(r"Photo \d+: (\S+)", words):
            photo = found.group(1)
            report.photos[photo] = {}
        elif words.endswith(":") and not words.startswith("Cumulative"):
            key = words.rstrip(":")
            key = _CAMERA_KEYS.get(key, key.split(" - ")[0])
        elif words.startswith("Value:"):
            value = Printed(words.split()[1])
            if photo is None:
                report.cameras[key] = (value, None)
        elif words.startswith("Deviation:") and value is not None:
            deviation = Printed(words.split()[1])
            if photo is None:
                report.cameras[key] = (value, deviation)
            else:
                report.photos[photo][key] = (value, deviation)
        elif words.startswith("Correlations over") and photo is None:
            for other, percent in re.findall(r"(\w+):(-?[\d.]+)%", words.partition("%")[2]):
                report.correlations[key, other] = Printed(percent)
    report.control.update(_points(text, "Ctrl measurements"))
    report.checks.update(_points(text, "Check measurements"))
    return report


@pytest.fixture(scope="session")
def dbat_report() -> Callable[[Path], DbatReport]:
    """Reader of DBAT's reports."""
    return read_dbat_report


@pytest.fixture(scope="session")
def adjusted(
    tmp_path_factory: pytest.TempPathFactory,
) -> Callable[[Block], tuple[Block, Solution]]:
    """Adjusts a block; gives what the run folder says, and the solution."""

    def run(block: Block) -> tuple[Block, Solution]:
        assembly = assemble(block)
        solution = adjust(assembly.network)
        folder = tmp_path_factory.mktemp("run")
        write_result(folder, result_of(block, assembly, solution))
        return adjusted_block(read_result(folder))[0], solution

    return run
