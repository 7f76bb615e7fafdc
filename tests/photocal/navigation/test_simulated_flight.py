"""A whole simulated flight: what is wrong in its project is caught in the summary of the exposures."""

from __future__ import annotations

import csv
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from photocal.block.project import read_project
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue
from photocal.navigation.exposure_run import (
    ExposureChoices,
    ExposureRun,
    choices_of_project,
    exposures_text,
    place_exposures,
    run_exposures,
)
from photocal.navigation.ppk_result import PpkFigures
from tests.conftest import needs_engine
from tests.photocal.findings.english import english
from tests.simulated import FLIGHT, fly

GEOID_M = 9.0


@dataclass(frozen=True)
class Flight:
    """A simulated flight, processed with a right project; the true orientations stand for a block's."""

    choices: ExposureChoices
    run: ExposureRun
    shutter_s: float

    def again(self, choices: ExposureChoices) -> ExposureRun:
        """The exposures anew from the same trajectory, with other choices."""
        corrected = {**self.run.figures["ppk"]}
        del corrected["common"]
        return place_exposures(choices, self.run.trajectory, PpkFigures.of(corrected))


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    needs_engine()
    folder = tmp_path_factory.mktemp("flight")
    place = tomllib.loads(FLIGHT.read_text())["place"] | {"geoid_m": GEOID_M}
    project = fly(folder, place=place)
    truth = folder / "truth" / "exposures.csv"
    choices = replace(choices_of_project(read_project(project)), oriented=truth)
    with truth.open() as stream:
        shutter = [int(row["middle_gps_ns"]) - int(row["event_gps_ns"]) for row in csv.DictReader(stream)]
    run = run_exposures(choices, tmp_path_factory.mktemp("ppk"))
    return Flight(choices, run, float(np.median(shutter)) / 1e9)


def failed(run: ExposureRun) -> dict[str, Finding]:
    return {check.code: check for check in run.checks if check.severity == "grave"}


def test_a_right_project_passes(flight: Flight) -> None:
    assert failed(flight.run) == {}
    assert flight.run.figures["placed"] == flight.run.figures["events"]
    told = exposures_text(flight.run.figures, catalogue("en"))
    assert "FAILED" not in told
    assert "air between base and rover" in told


def test_17_ms_at_4_and_7_m_s(flight: Flight) -> None:
    run = flight.again(replace(flight.choices, delay_s=-0.017))
    check = failed(run)["time-offset"]
    # What the delay lacks, and the shutter's own delay that the project does not know.
    value, sigma = check.figures["value"][0], check.figures["sigma"][0]
    assert sigma < 0.001
    assert value == pytest.approx(0.017 + flight.shutter_s, abs=4 * sigma)
    assert "later than stamped" in exposures_text(run.figures, catalogue("en"))


def test_swapped_axes_of_the_lever_arm(flight: Flight) -> None:
    rig = flight.choices.rig
    assert rig.lever_m is not None
    run = flight.again(replace(flight.choices, rig=replace(rig, lever_m=rig.lever_m[[2, 1, 0]])))
    check = failed(run)["lever-arm-axes"]
    right = ", ".join(f"{v:+.3f} {n}" for v, n in zip(rig.lever_m, ("forward", "right", "down"), strict=True))
    assert right in english(check)
    assert any(found["code"] == "lever-arm-axes" for found in run.figures["findings"])


@pytest.mark.slow
def test_orthometric_heights_declared_ellipsoidal(flight: Flight, tmp_path: Path) -> None:
    sources = flight.choices.sources
    assert sources.base_position is not None
    lat, lon, height = sources.base_position.split(",")
    lower = replace(sources, base_position=f"{lat},{lon},{float(height) - GEOID_M}")
    run = run_exposures(replace(flight.choices, sources=lower, oriented=None), tmp_path)
    check = failed(run)["height-kind"]
    assert "orthometric, not ellipsoidal" in english(check)
    assert check.figures["geoid_m"] == pytest.approx(GEOID_M, abs=0.5)
    assert any(found["code"] == "base-position" for found in run.figures["ppk"]["findings"])
