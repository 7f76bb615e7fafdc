"""Frames and epochs against published coordinates, poles and velocities."""

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError
from photocal.geometry.realizations import frame_shift, known_realization, realization

# IGS and RBMC station in Brasilia, about.
BRASILIA = np.array([4115014.0, -4550641.0, -1741444.0])
# Milliarcseconds and metres a year.
_MAS = np.radians(1.0 / 3600.0 / 1000.0)


def shift(place: np.ndarray, source: str, target: str) -> np.ndarray:
    """Shift between two realizations that a way is known of."""
    found = frame_shift(place, realization(source), realization(target))
    assert found is not None
    return found.shift_m


def test_itrf_to_gda2020_is_that_of_the_technical_manual() -> None:
    """ICSM, GDA2020 Technical Manual: ALIC, ITRF2014 at 2018.0 to GDA2020."""
    alic = np.array([-4052052.6588, 4212835.9938, -2545104.6946])
    moved = alic + shift(alic, "ITRF2014@2018.0", "GDA2020")
    assert moved == pytest.approx([-4052052.7373, 4212835.9835, -2545104.5867], abs=2e-4)


def test_today_to_sirgas_is_the_published_rotation_of_the_plate() -> None:
    """Altamimi et al. (2017), table 3, South America: -0.270, -0.301, -0.140 mas a year, of another solution.

    The two models' velocities differ by 0.6 mm a year; 1 mm a year is the stated sigma.
    """
    years = 2026.9 - 2000.4
    velocity = np.cross(np.array([-0.270, -0.301, -0.140]) * _MAS, BRASILIA)
    found = frame_shift(BRASILIA, realization("IGS20@2026.9"), realization("SIRGAS2000"))
    assert found is not None
    # ITRF2020 and ITRF2000 lie 4 cm apart in Z by then (their published parameters).
    between = shift(BRASILIA, "ITRF2020@2000.4", "ITRF2000@2000.4")
    assert np.abs(found.shift_m - between + velocity * years).max() < found.sigma_m
    assert found.size_m == pytest.approx(0.36, abs=0.02)
    assert found.shift_enu_m[1] < -0.3


def test_etrs89_stays_with_europe() -> None:
    """EUREF: ETRS89 and ITRS part by 2.5 cm a year since 1989, to the north-east."""
    wettzell = np.array([4075580.0, 931853.7, 4801568.0])
    found = frame_shift(wettzell, realization("IGS20@2024.0"), realization("ETRF2020"))
    assert found is not None
    assert found.size_m == pytest.approx(0.025 * 35, rel=0.1)
    assert (found.shift_enu_m[:2] < -0.5).all()


def test_there_and_back_is_nothing() -> None:
    there = shift(BRASILIA, "IGS14@2019.3", "SIRGAS2000")
    back = shift(BRASILIA + there, "SIRGAS2000", "IGS14@2019.3")
    assert np.abs(there + back).max() < 1e-6


def test_a_frame_is_known_by_what_people_write() -> None:
    assert realization("igs20@2024.97") == realization("IGb20@2024.97")
    assert realization("ITRF14@2010").frame == "ITRF2014"
    assert realization("EPSG:31982+5773").frame == "SIRGAS 2000"
    assert str(realization("EPSG:4674")) == "SIRGAS 2000, epoch 2000.4"
    for vague in ("NAD83", "WGS84", "EPSG:4326", "EPSG:32722", "EPSG:99999999"):
        assert known_realization(vague) is None
    with pytest.raises(ConfigurationError, match="no frame 'IGS99'"):
        realization("IGS99")
    with pytest.raises(ConfigurationError, match="epoch"):
        realization("IGS20@today")


def test_without_an_epoch_or_a_plate_nothing_is_guessed() -> None:
    assert frame_shift(BRASILIA, realization("IGS20"), realization("SIRGAS2000")) is None
    assert frame_shift(BRASILIA, realization("IGS20@2026"), realization("ITRF2014@2010")) is None
