"""The comparison of the demonstration with its truth."""

from __future__ import annotations

import json
from pathlib import Path

from photocal.demo.truth import against_truth, table


def _written(folder: Path, c: float) -> None:
    rig = {"camera_to_antenna_m": [0.0, 0.0, 0.1], "boresight_deg": [0.0] * 3, "time_offset_s": 0.002}
    truth = {"camera": {"id": "S", "mm": {"c": 8.0}, "px": {"c": 1600.0}}, "rig": rig}
    (folder / "truth").mkdir(parents=True)
    (folder / "truth" / "truth.json").write_text(json.dumps(truth), encoding="utf-8")
    held = {"value": 0.0, "sigma": 0.0, "estimated": False}
    names = [f"{what}_{axis}" for what in ("lever_arm", "boresight") for axis in "xyz"]
    mounting = dict.fromkeys(names, held) | {
        "time_offset": {"value": 0.003, "sigma": 0.001, "estimated": True}
    }
    parameters = {"c": {"value": c, "sigma": 0.01, "estimated": True}, "x0": held}
    result = {"cameras": {"S": {"unit": "mm", "parameters": parameters}}, "mounting": mounting}
    check = {"methods": {"direct": {"check": {"n": 3, "errors_over_prediction": 1.2}}}}
    for stage, name, content in (("calibration", "result", result), ("georeferencing", "check", check)):
        (folder / "work" / stage).mkdir(parents=True)
        (folder / "work" / stage / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")


def test_what_lies_beyond_three_sigma_is_marked(tmp_path: Path) -> None:
    for name, c, agrees in (("good", 8.02, True), ("bad", 8.04, False)):
        _written(tmp_path / name, c)
        rows = against_truth(tmp_path / name / "truth", tmp_path / name / "work")
        assert [row.name for row in rows] == ["c", "time offset", "direct, check errors/prediction"]
        assert rows[0].agrees is agrees
        assert abs(rows[1].deviation - 1.0) < 1e-9
        assert ("<--" in table(rows)) is not agrees
