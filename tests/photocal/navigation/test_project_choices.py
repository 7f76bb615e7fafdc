"""What a project file asks of PPK and exposures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import InputMalformedError
from photocal.block.project import AirAtBase, read_project
from photocal.measurement.image_metadata import read_images
from photocal.navigation.exposure_run import choices_of_project

PROJECT = """
[project]
name = "field"
crs = "EPSG:31982"
height = "ellipsoidal"
output = "work"
[flight]
logs = ["a.mcap", "b.mcap"]
vehicle = "drone"
base_position = [-22.7, -43.2, 30.0]
base_antenna_height_m = 1.5
base_sigma_m = [0.01, 0.02, 0.03]
weather = { temperature_c = 21.5, relative_humidity_percent = 60.0 }
edge = "falling"
delay_s = 0.004
clock_offset_s = 12.0
[images]
times = "times.csv"
[rig]
camera_to_antenna_m = [0.1, -0.2, -0.3]
camera_to_antenna_sigma_m = 0.02
boresight_deg = [0.0, 0.0, 1.0]
boresight_sigma_deg = "free"
attitude_sigma_deg = [0.3, 0.3, 0.6]
time_offset_s = 0.001
time_offset_sigma_s = 0.005
camera_axes = ["backward", "right", "up"]
"""


def test_every_key_finds_its_place(tmp_path: Path) -> None:
    path = tmp_path / "project.toml"
    path.write_text(PROJECT)
    choices = choices_of_project(read_project(path))
    sources, rig = choices.sources, choices.rig
    assert [log.name for log in sources.log.paths] == ["a.mcap", "b.mcap"]
    assert (sources.vehicle_link, sources.rover_link) == ("drone", "rover")
    assert sources.base_position == "-22.7,-43.2,30.0"
    assert (sources.base_antenna_m, sources.rover_antenna_m) == (1.5, None)
    assert sources.base_sigma_m is not None
    assert sources.base_sigma_m.tolist() == [0.01, 0.02, 0.03]
    assert sources.weather == AirAtBase(temperature_c=21.5, relative_humidity_percent=60.0)
    assert (choices.edge, choices.delay_s, choices.largest_offset_s) == ("falling", 0.004, 12.0)
    # From the antenna to the camera here, the other way round in the project.
    assert rig.lever_m is not None
    assert rig.lever_m.tolist() == [0.1, -0.2, -0.3]
    assert rig.lever_sigma_m.tolist() == [0.02] * 3
    assert np.degrees(rig.boresight) == pytest.approx([0, 0, 1])
    assert np.degrees(rig.boresight_sigma) == pytest.approx([10, 10, 10])
    assert (rig.time_offset_s, rig.time_offset_sigma_s) == (0.001, 0.005)
    # The right edge of the image points backward, its upper edge to the right.
    assert rig.axes @ [-1.0, 0.0, 0.0] == pytest.approx([1, 0, 0])
    assert rig.axes @ [0.0, 1.0, 0.0] == pytest.approx([0, 1, 0])


def test_a_table_stands_for_pictures(tmp_path: Path) -> None:
    table = tmp_path / "times.csv"
    table.write_text("image,taken\nB.JPG,2025-06-15T14:01:09.262\nA.JPG,2025-06-15T14:01:06\n")
    first, second = read_images(table)
    assert (first.name, first.resolution_s, second.resolution_s) == ("A.JPG", 1.0, 0.001)
    assert first.time_s is not None
    assert second.time_s is not None
    assert second.time_s - first.time_s == pytest.approx(3.262)


def test_a_table_without_a_time_is_refused(tmp_path: Path) -> None:
    table = tmp_path / "times.csv"
    table.write_text("image,taken\nA.JPG,noon\n")
    with pytest.raises(InputMalformedError, match="line 2"):
        read_images(table)
