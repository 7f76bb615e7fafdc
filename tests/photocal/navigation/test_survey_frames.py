"""Marks of a survey in the frame of its system."""

from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import PhotocalError
from photocal.base.geodesy import geocentric
from photocal.geometry.realizations import realization
from photocal.navigation.baseline_network import GroundMark
from photocal.navigation.survey import frame_of_orbits, frame_told, in_system

MARK = GroundMark("M1", geocentric(-25.45, -49.23, 925.8), np.zeros((3, 3)))
# First line of a file of precise orbits as the standard has it (SP3-d, Hilla 2016, page 2).
SP3 = "#dP2013  4  3  0  0  0.00000000      96 ORBIT IGS14 HLM  NGS\n"


def test_a_mark_of_today_is_taken_to_sirgas_with_the_sigma_of_the_way() -> None:
    moved, done = in_system(MARK, frame_told("M1", "IGS20@2026.9"), "EPSG:31982")
    assert done is not None
    assert done.moved is not None
    assert moved.xyz_m - MARK.xyz_m == pytest.approx(done.moved.shift_m)
    assert np.sqrt(np.diag(moved.covariance_m2)) == pytest.approx(done.moved.sigma_m)
    assert 0.026 < done.moved.sigma_m < 0.03


def test_a_mark_without_a_frame_or_in_that_of_the_survey_stays() -> None:
    for told, crs in (("", "EPSG:31982"), ("SIRGAS2000", "EPSG:31982"), ("IGS20@2026.9", None)):
        assert in_system(MARK, frame_told("M1", told), crs) == (MARK, None)


def test_a_frame_in_which_the_ground_moves_needs_an_epoch() -> None:
    with pytest.raises(PhotocalError, match="M1: coordinates in IGS20 change with time"):
        frame_told("M1", "IGS20")


def test_the_epoch_of_a_file_stands_in_for_one_that_is_not_told() -> None:
    assert frame_told("M1", "IGS20", 2026.9) == realization("IGS20@2026.9")
    assert frame_told("M1", "IGS20@2025.0", 2026.9) == realization("IGS20@2025.0")
    # In a system of one plate the ground stays where it is.
    assert frame_told("M1", "SIRGAS2000", 2026.9) == frame_told("M1", "SIRGAS2000")


def test_orbits_tell_their_frame(tmp_path: Path) -> None:
    path = tmp_path / "orbits.sp3"
    path.write_text(SP3)
    (tmp_path / "clocks.clk").write_text("     3.00           C  RINEX VERSION / TYPE\n")
    assert frame_of_orbits((tmp_path / "clocks.clk", path)) == realization("IGS14")
