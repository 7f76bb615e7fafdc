"""Long study: what all positions of a flight share, against the truth of simulated flights.

Writes `docs/evidence/common_errors.md`. The mean error of a flight's heights: as the engine has it, corrected
by the climate and by the weather at the base, against the standard deviation that is stated for it.

Run: `make evidence`, or `python -m tests.evidence.common_errors`.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquire.simulate.gnss.settings import SkySettings
from photocal.block.project import AirAtBase
from photocal.navigation.common_errors import CommonErrors, remaining_lapse
from photocal.navigation.ppk_result import Ppk
from tests.acquire.simulate.gnss.flights import BASE_DEG
from tests.evidence.ppk_fixes import Case, flown

Floats = NDArray[np.float64]
FLIGHTS = 10
# Of the year: all flights are on 15 June.
DAY = 166.0
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "common_errors.md"
CASES = tuple(
    Case(f"{height} m above the base, humidity {round(100 * humidity)} %", raised_m=height - 50.0,
         sky=SkySettings(relative_humidity=humidity))
    for height, humidity in ((50, 0.0), (50, 0.5), (120, 0.5), (120, 1.0))
)  # fmt: skip


def corrections(common: CommonErrors, humidity: float) -> dict[str, CommonErrors]:
    """Return the common errors with the air as the climate has it, and as it was measured at the base."""
    lat, _, height = BASE_DEG
    # The simulator's standard atmosphere: 15 degrees at sea level.
    measured = AirAtBase(temperature_c=15.0 - 0.0065 * height, relative_humidity_percent=100 * humidity)
    return {
        "climate": replace(common, lapse=remaining_lapse(lat, height, DAY)),
        "weather": replace(common, lapse=remaining_lapse(lat, height, DAY, measured)),
    }


def means(result: Ppk, error: Floats, humidity: float) -> dict[str, tuple[float, float]]:
    """Return the mean error of the heights of a flight and its stated sigma, m, by kind of correction."""
    assert result.common is not None
    t = result.trajectory
    fixed = t.status == "fixed"
    mean = float(error[fixed, 2].mean())
    above = float(np.mean(t.height_m[fixed])) - result.common.base_height_m
    found = {"engine": (mean, float("nan"))}
    for name, common in corrections(result.common, humidity).items():
        sigma = float(np.hypot(common.shift_sigma_m[2], common.zenith_scale_sigma * above))
        found[name] = (mean + above * float(common.correction_per_metre[2]), sigma)
    return found


def row(case: Case) -> str:
    """Return a line of the table for all flights of a case."""
    assert case.sky is not None
    flights: dict[str, list[tuple[float, float]]] = {}
    lasts, level = [], []
    for seed in range(FLIGHTS):
        with tempfile.TemporaryDirectory() as scratch:
            result, error = flown(case, 200 + seed, Path(scratch))
        assert result.common is not None
        lasts.append(result.common.correlation_time_s or float("nan"))
        fixed = result.trajectory.status == "fixed"
        level.append(error[fixed, :2].mean(axis=0) / result.common.shift_sigma_m[:2])
        for name, one in means(result, error, case.sky.relative_humidity).items():
            flights.setdefault(name, []).append(one)
        sys.stderr.write(f"\r{case.name}: flight {seed + 1} of {FLIGHTS}   ")
    cells = [case.name]
    for told in flights.values():
        mean, sigma = np.array(told).T
        cells.append(f"{1e3 * mean.mean():+.1f} +- {1e3 * mean.std(ddof=1):.1f}")
        if np.isfinite(sigma).all():
            cells += [f"{1e3 * np.median(sigma):.1f}", f"{np.sqrt(np.mean((mean / sigma) ** 2)):.2f}"]
    cells += [f"{np.sqrt(np.mean(np.square(level))):.2f}", f"{np.median(lasts):.0f}"]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Write the table."""
    columns = (
        "case", "engine, mm", "by the climate, mm", "stated, mm", "error/sigma", "by the weather, mm",
        "stated, mm", "error/sigma", "error/sigma, horizontal", "errors last, s",
    )  # fmt: skip
    lines = [
        "# What all positions of a flight share: simulated flights with known truth",
        "",
        f"{FLIGHTS} flights of 240 s at 1 Hz for each line, each with another satellite geometry. The",
        "height errors of a flight are averaged; the columns give mean and scatter of this average over",
        "the flights. They are given as the engine has it, corrected by the climate at the place, and by",
        "the weather measured at the base. Stated: the median of its stated standard deviation.",
        "Error/sigma: root mean square, 1 when errors are as large as stated, below 1 when they are",
        "smaller. Made by `python -m tests.evidence.common_errors`.",
        "",
        f"| {' | '.join(columns)} |",
        "|---" * len(columns) + "|",
        *(row(case) for case in CASES),
        "",
        "The engine assumes that the air between base and rover is dry. The simulated air is that of the",
        "standard atmosphere, 15 degrees at sea level. At 50 % humidity it holds less than half of the",
        "water vapour that the climate of this place (23 degrees south) has in June, at 100 % nearly as",
        "much.",
    ]
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.stderr.write(f"\nwrote {OUTPUT.name}\n")


if __name__ == "__main__":
    main()
