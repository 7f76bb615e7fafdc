"""The planned line: places of a mission as ground stations write it, and none of what is no place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquire.monitor.planned import planned_line
from photocal.base.errors import InputMalformedError, InputNotFoundError

# As the definition of the format has it: index, current, frame, command, four parameters, place, on.
HOME = "0\t1\t0\t16\t0\t0\t0\t0\t-22.7\t-43.2\t30.0\t1"
MISSION = [
    HOME,
    "1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t60.000\t1",
    "2\t0\t3\t16\t0\t0\t0\t0\t-22.70100000\t-43.20200000\t60.000\t1",
    "3\t0\t2\t206\t12.5\t0\t1\t0\t0\t0\t0\t1",
    "4\t0\t3\t16\t0\t0\t0\t0\t-22.70300000\t-43.20200000\t60.000\t1",
    "5\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1",
]


def test_places_are_read_and_home_orders_and_return_are_not(tmp_path: Path) -> None:
    path = tmp_path / "flight.waypoints"
    path.write_text("\n".join(["QGC WPL 110", *MISSION]) + "\n")
    np.testing.assert_array_equal(planned_line(path), [[-22.701, -43.202], [-22.703, -43.202]])


@pytest.mark.parametrize(
    "text", ["", "QGC WPL 120\n", "QGC WPL 110\n1\t0\n", "QGC WPL 110\na b c d e f g h i j\n"]
)
def test_what_is_no_mission_is_told(tmp_path: Path, text: str) -> None:
    path = tmp_path / "flight.waypoints"
    path.write_text(text)
    with pytest.raises(InputMalformedError):
        planned_line(path)
    with pytest.raises(InputNotFoundError):
        planned_line(tmp_path / "none.waypoints")
