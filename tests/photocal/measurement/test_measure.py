"""The step from pictures to a block, called from Python."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from photocal.base.errors import ConfigurationError, InputNotFoundError
from photocal.block.project import read_project
from photocal.measurement.options import MeasureOptions
from photocal.measurement.picture_block import measure
from tests.photocal.measurement.laboratory import laboratory, picture, write_pictures


def test_a_folder_of_a_board_becomes_a_block(shared: Path) -> None:
    pictures = shared / "data/calib-chessboard-picam/half"
    measured = measure(str(pictures), MeasureOptions(board="10x7", square_m=0.025))
    assert measured.record["kind"] == "board"
    assert len(measured.block.images.names) == 10
    # Nine by six inner corners, a square apart.
    across = measured.block.points.values[:, 0].reshape(6, 9)
    assert np.diff(across, axis=1) == pytest.approx(0.025)
    (own,) = measured.block.cameras
    # OpenCV with five coefficients, computed beside the data: 1317.8 +- 17.0.
    assert own.value("c") == pytest.approx(1317.8, abs=3 * 17.0)


def test_a_picture_of_too_few_targets_is_left_out(tmp_path: Path) -> None:
    lab = laboratory(30, 5)
    write_pictures(lab, tmp_path / "pictures")
    # In the last picture all but the first three targets were covered; the first lies outside of it.
    covered = picture(replace(lab, corners=lab.corners[:3]), 4, np.random.default_rng(2))
    cv2.imwrite(str(tmp_path / "pictures/lab04.png"), covered)
    measured = measure(tmp_path / "pictures", MeasureOptions(field="4x4_100"))
    (left,) = measured.record["left_out"]
    assert left == {"image": "lab04.png", "reason": "2 targets only"}
    assert measured.block.images.names == ("lab00.png", "lab01.png", "lab02.png", "lab03.png")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"charuco": "4x4_50"}, "--charuco needs a board"),
        ({"workers": 2, "cluster": "tcp://host:8786"}, "--workers and --cluster"),
    ],
)
def test_options_that_contradict_each_other_are_refused(options: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        MeasureOptions(**options)  # type: ignore[arg-type]


def test_options_that_do_not_go_with_the_pictures_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="--marks has no coordinates"):
        measure(tmp_path, MeasureOptions(marks=(tmp_path / "marks.csv",)))
    with pytest.raises(InputNotFoundError):
        measure(tmp_path / "nothing")
    path = tmp_path / "project.toml"
    path.write_text('[project]\nname = "p"\ncrs = "local"\nheight = "local"\noutput = "work"\n')
    with pytest.raises(ConfigurationError, match="names its own control"):
        measure(read_project(path), MeasureOptions(board="10x7"))
