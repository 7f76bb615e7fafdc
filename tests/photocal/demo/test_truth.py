"""The comparison of the demonstration with its truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from photocal.block.results.folder import write_result
from photocal.block.results.result import (
    AdjustedPoints,
    BlockFacts,
    CheckSummary,
    MountingValue,
    Residuals,
    Result,
    Software,
)
from photocal.demo.simulated import against_truth, table
from photocal.geometry.camera import PARAMETERS, camera
from photocal.geometry.oriented_images import OrientedImages


def _written(folder: Path, c: float) -> None:
    rig = {"camera_to_antenna_m": [0.0, 0.0, 0.1], "boresight_deg": [0.0] * 3, "time_offset_s": 0.002}
    truth = {"camera": {"id": "S", "mm": {"c": 8.0}, "px": {"c": 1600.0}}, "rig": rig}
    check = {"methods": {"direct": {"check": {"n": 3, "errors_over_prediction": 1.2}}}}
    for stage, name, content in (("truth", "truth", truth), ("work/georeferencing", "check", check)):
        (folder / stage).mkdir(parents=True)
        (folder / stage / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")
    (folder / "work" / "calibration").mkdir()
    write_result(folder / "work" / "calibration", _result(c))


def _result(c: float) -> Result:
    """One image of one point; c with a sigma of 0.01 mm, the time offset of 1 ms, all else held."""
    given = camera("S", "brown-ideal", "mm", (4000, 3000), (0.005, 0.005), {"c": 8.0}, estimate=("c",))
    count = len(PARAMETERS)
    lens = given.adjusted([c, *given.values[1:]], [0.01, *[0.0] * (count - 1)], np.eye(count))
    names = [f"{what}_{axis}" for what in ("lever_arm", "boresight") for axis in "xyz"]
    mounting = {name: MountingValue(0.0, 0.0, estimated=False) for name in names}
    mounting["time_offset"] = MountingValue(0.003, 0.001, estimated=True)
    first, nothing = np.zeros(1, dtype=np.int64), np.full((1, 2), np.nan)
    return Result(
        software=Software("test", "0"),
        block=BlockFacts("demo", "local", "", "px", "pixel"),
        inputs=(), converged=True, iterations=1, observations=0, unknowns=0, degrees_of_freedom=0,
        chi_squared=0.0, sigma0_squared=None, global_test=None, groups=(), checks=CheckSummary(0, {}),
        mounting=mounting,
        cameras={"S": lens},
        images=OrientedImages(("1",), (lens,), first, np.zeros((1, 6)), np.zeros((1, 6, 6))),
        points=AdjustedPoints(("1",), ("tie",), np.zeros((1, 3)), np.zeros((1, 3, 3)), first),
        residuals=Residuals(("1",), ("1",), first, first, np.zeros((1, 2)), *[nothing] * 3),
    )  # fmt: skip


def test_what_lies_beyond_three_sigma_is_marked(tmp_path: Path) -> None:
    for name, c, agrees in (("good", 8.02, True), ("bad", 8.04, False)):
        _written(tmp_path / name, c)
        rows = against_truth(tmp_path / name / "truth", tmp_path / name / "work")
        assert [row.name for row in rows] == ["c", "time offset", "direct, check errors/prediction"]
        assert rows[0].agrees is agrees
        assert abs(rows[1].deviation - 1.0) < 1e-9
        assert ("<--" in table(rows)) is not agrees
