"""Positions of pictures in a caster's frame."""

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import enu_offsets
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.position_files import in_project, moved_finding, shift_of_positions

PICTURE = ImageFacts(
    "a.jpg", (4000, 3000), latitude_deg=-25.45, longitude_deg=-49.23, altitude_m=1000.0,
    position_sigma_m=(0.01, 0.01, 0.02),
)  # fmt: skip


def test_positions_of_a_caster_go_to_sirgas() -> None:
    shift = shift_of_positions("IGS20@2026.9", "EPSG:31982", PICTURE)
    moved = in_project(PICTURE, shift)
    place = [np.array([v]) for v in (moved.latitude_deg, moved.longitude_deg, moved.altitude_m)]
    at = np.array([PICTURE.latitude_deg, PICTURE.longitude_deg, PICTURE.altitude_m])
    assert enu_offsets(place[0], place[1], place[2], at)[0] == pytest.approx(shift.shift_enu_m, abs=1e-6)
    # 26.5 years of the South American plate.
    assert 0.30 < shift.size_m < 0.40
    assert moved.position_sigma_m[2] == pytest.approx(np.hypot(0.02, shift.sigma_m))
    assert moved_finding(shift).code == "positions-moved"


def test_what_cannot_be_moved_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="epoch"):
        shift_of_positions("IGS20", "EPSG:31982", PICTURE)
    with pytest.raises(ConfigurationError, match="no transformation is known"):
        shift_of_positions("IGS20@2026.9", "EPSG:32722", PICTURE)


def test_a_picture_without_a_position_stays() -> None:
    bare = ImageFacts("b.jpg", (4000, 3000))
    assert in_project(bare, shift_of_positions("IGS20@2026.9", "EPSG:31982", PICTURE)) is bare
