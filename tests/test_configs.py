"""configs/: what a person edits is read by the program that it is for, and says what it is."""

from __future__ import annotations

import datetime as dt
import tomllib
from pathlib import Path

import numpy as np
import pytest

from acquire.recording.configuration import read_configuration
from photocal.analysis.accuracy.standard import ScaleStandard, load_standard
from photocal.analysis.stability.camera_file import read_camera_file
from photocal.block.project import RigSettings
from photocal.report.certificate_metadata import read_particulars
from photocal.report.studies.study import shipped

CONFIGS = Path(__file__).parents[1] / "configs"
CAMERAS, RIGS = sorted((CONFIGS / "cameras").glob("*.toml")), sorted((CONFIGS / "rigs").glob("*.toml"))
# Sensor and lens by the maker's data sheets: longer side, mm; c, mm.
MAKERS = {
    "P1": (35.9, 35.0),
    "FC6310R": (13.2, 8.8),
    "FC6360": (4.87, 5.74),
    "M3E": (17.3, 12.29),
    "H20T-wide": (6.29, 4.5),
    "DSC-RX1RM2": (35.9, 35.0),
    "ILCE-6000": (23.5, 20.0),
    "HERO4 Black": (6.2, 2.77),
    "Sequoia-green": (4.8, 3.98),
}


def test_every_file_begins_with_what_it_is() -> None:
    files = [
        path
        for path in CONFIGS.rglob("*.toml")
        if path.relative_to(CONFIGS).parts[0] != "studies" or path.name == "study.toml"
    ]
    assert len(files) > 14
    assert [path.name for path in files if not path.read_text(encoding="utf-8").startswith("#")] == []


def test_the_recording_is_read() -> None:
    made = read_configuration(CONFIGS / "record.toml")
    assert [link.url.partition(":")[0] for link in made.link] == ["udp", "serial", "ntrip"]


@pytest.mark.parametrize("path", CAMERAS, ids=lambda path: path.stem)
def test_cameras_are_those_of_their_makers(path: Path) -> None:
    (camera,) = read_camera_file(path).calibrations
    width, c = MAKERS[camera.id]
    assert max(camera.size_px) * camera.pitch[0] == pytest.approx(width, rel=0.01)
    assert camera.value("c") == c
    assert camera.guessed


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_rigs_are_read(path: Path) -> None:
    rig = RigSettings.model_validate(tomllib.loads(path.read_text(encoding="utf-8"))["rig"])
    assert rig.mounting().lever_arm_m == rig.camera_to_antenna_m


def test_standards_are_read() -> None:
    standard = load_standard(str(CONFIGS / "standards" / "nmas.toml"))
    assert isinstance(standard, ScaleStandard)
    plane, heights = standard.tables
    # 1/50 inch at 1:24 000 is 40 feet on the ground; half of a contour interval of 10 m.
    assert plane.limits(24_000.0)[-1].pec_m == pytest.approx(40 * 0.3048, rel=1e-4)
    assert heights.limits(10.0)[0].pec_m == pytest.approx(5.0)


def test_recommended_limits_of_inspire() -> None:
    """Elevation, table 11: E / 10 000 and a sixth of the interval, which E / 1000 approximates."""
    standard = load_standard(str(CONFIGS / "standards" / "inspire-elevation.toml"))
    assert isinstance(standard, ScaleStandard)
    plane, heights = standard.tables
    assert plane.limits(5_000.0)[0].ep_m == pytest.approx(0.5)
    assert heights.limits(5.0)[0].ep_m == pytest.approx(5 / 6)
    # Radius of 90 % of a circular normal distribution, and half width of 90 % of a normal one.
    assert plane.limits(5_000.0)[0].pec_m == pytest.approx(0.5 * np.sqrt(np.log(10)), rel=1e-4)
    assert heights.limits(5.0)[0].pec_m == pytest.approx(5 / 6 * 1.644854, rel=1e-4)


def test_particulars_and_studies_are_read() -> None:
    example = CONFIGS / "certificates" / "example_particulars.toml"
    assert read_particulars(example, dt.date(2026, 3, 5)) is not None
    assert {path.parent.name for path in (CONFIGS / "studies").glob("*/study.toml")} == set(shipped())
