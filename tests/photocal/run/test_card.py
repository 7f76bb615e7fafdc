"""The card of a drone, from `photocal new` to the calibration, against the camera that drew its pictures."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.photocal.conftest import Answer
from tests.simulated import PLANS, simulate


@pytest.mark.parametrize(("fx", "readout_s"), [("942.9", 0.0), ("942.4", 0.02)])
def test_scale_and_readout_are_told_apart(
    fx: str, readout_s: float, photocal: Callable[..., Answer], tmp_path: Path
) -> None:
    """A y scale is no readout; what vibrates within one takes neither c nor the sigmas along."""
    plan = (PLANS / "drone.toml").read_text(encoding="utf-8")
    plan = plan.replace("fx = 942.9\n", f"fx = {fx}\nreadout_s = {readout_s}\n")
    assert f"readout_s = {readout_s}" in plan
    (tmp_path / "flight.toml").write_text(plan, encoding="utf-8")
    site = simulate(tmp_path / "card", tmp_path / "flight.toml")
    assert photocal("new", site, "--height", "ellipsoidal").code == 0
    said = photocal("run", site / "project.toml", "--until", "calibration")
    assert said.code == 0, said.err
    truth = json.loads((tmp_path / "card" / "truth" / "truth.json").read_text())["camera"]["px"]
    result = json.loads((site / "work" / "calibration" / "result.json").read_text())
    (camera,) = result["cameras"].values()
    for name, true in (("c", truth["c"]), ("B1", truth["B1"]), ("readout", readout_s)):
        found = camera["parameters"].get(name, {"estimated": False})
        assert found["estimated"] == (true != 0.0), name
        assert true == 0.0 or abs(found["value"] - true) < 3 * found["sigma"], name
    assert result["sigma0_squared"] == pytest.approx(1.0, abs=0.1)
