"""Damaged RINEX files are refused in words."""

from __future__ import annotations

from pathlib import Path

import pytest

from photocal.base.errors import InputMalformedError
from photocal.navigation.precise_results import read_observation_file

HEADER = (
    f"{'     3.04           O':60}RINEX VERSION / TYPE\n"
    f"{'G    2 C1C L':60}SYS / # / OBS TYPES\n"
    f"{'        0.1000        0.0000        0.0000':60}ANTENNA: DELTA H/E/N\n"
    f"{'':60}END OF HEADER\n"
)
EPOCH = "> 2024 01 01 00 00 00.0000000  0  9\n"


def test_a_whole_one_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.obs"
    path.write_text(HEADER + EPOCH)
    found = read_observation_file(path)
    assert (found.antenna_m, len(found.time), found.bands) == (0.1, 1, frozenset())


@pytest.mark.parametrize(
    ("whole", "damaged"), [("0.1000", "0.1 00"), ("2024 01", "2024 13"), ("2024", "9999")]
)
def test_a_damaged_one_is_refused(tmp_path: Path, whole: str, damaged: str) -> None:
    path = tmp_path / "a.obs"
    path.write_text((HEADER + EPOCH).replace(whole, damaged, 1))
    with pytest.raises(InputMalformedError):
        read_observation_file(path)
