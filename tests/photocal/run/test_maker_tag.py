"""Flights whose maker's tag is wrong, and nothing else: the camera is right, and a note speaks of the tag."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from photocal.block.results.adjusted import adjust_network
from photocal.block.results.folder import read_result
from photocal.commands.cli import app
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.measurement.maker_camera import tag_finding
from photocal.run.summary import calibration_findings
from tests.photocal import tagged

# A y up counts: what OpenCV has below the middle is negative.
TRUTH = {"c": tagged.FY, "x0": tagged.CX, "y0": -tagged.CY, "P1": 0.0, "P2": 0.0, "B1": 0.0, "B2": 0.0}
TRUTH |= {f"K{n}": k / tagged.FY ** (2 * n) for n, k in ((1, tagged.K1), (2, tagged.K2), (3, tagged.K3))}


def off(camera: Camera) -> list[str]:
    """Parameters that are farther than three sigmas from the truth."""
    return [n for n, v in TRUTH.items() if abs(camera.value(n) - v) > 3.0 * camera.sigma_of(n)]


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("ratio", "cy_sign", "p", "model"), [
    (1.009, 1, 0.0, "FC6310R"), (1.009, -1, 0.0, "FC6310R"), (0.991, 1, 0.0, "FC6360"),
    (1.009, -1, 0.004, "FC6360"),
])  # fmt: skip
def test_the_camera_is_right_whatever_the_tag_says(
    ratio: float, cy_sign: int, p: float, model: str, seed: int
) -> None:
    result = adjust_network(tagged.fly(tagged.tag(ratio, cy_sign, p, model), seed))
    (camera,) = result.cameras.values()
    assert off(camera) == []
    (found,) = calibration_findings(result)
    assert (found.code, found.severity) == ("maker-tag", "note")
    # Pixels that are 0.9 % too wide or too narrow are 7.2 px off at 800 px beside the middle.
    assert found.figures["px"] > 6.0
    assert "B1" in found.figures["names"]


def test_a_right_tag_is_not_spoken_of() -> None:
    result = adjust_network(tagged.fly(tagged.tag(1.0), 4))
    assert list(calibration_findings(result)) == []


@pytest.mark.parametrize(
    ("c_off", "ratio", "names"), [(17.0, 0.0, None), (17.0, 0.009, ("B1",)), (0.0, 0.009, ("B1",))]
)
def test_a_c_that_the_flight_leaves_open_hides_nothing_else(
    c_off: float, ratio: float, names: tuple[str, ...] | None
) -> None:
    """Pixels that the tag has 0.9 % too wide are 7.2 px off at 800 px beside the middle."""
    values, sigma = np.zeros(len(PARAMETERS)), np.zeros(len(PARAMETERS))
    values[PARAMETERS.index("c")] = 1939.0
    sigma[PARAMETERS.index("c")], sigma[PARAMETERS.index("B1")] = 19.0, 0.0006
    given = values.copy()
    given[PARAMETERS.index("c")] += c_off
    given[PARAMETERS.index("B1")] += ratio
    free = np.isin(PARAMETERS, ["c", "B1"])
    found = tag_finding(
        Camera(
            "p4m", "brown-ideal", "px", (1600, 1300), (1.0, 1.0), values, free, 0.0 * values + np.inf,
            affinity="after", stated_by="DewarpData", given=given, sigma=sigma,
        )
    )  # fmt: skip
    assert (None if found is None else found.figures["names"]) == names
    if found is not None and c_off:
        assert found.figures["px"] == pytest.approx(7.2, abs=0.01)
        assert found.figures["sigma_px"] == pytest.approx(0.48, abs=0.01)


@pytest.mark.parametrize(("cy_sign", "p"), [(1, 0.0), (-1, 0.004)])
def test_a_whole_run_of_33_pictures_is_usable(tmp_path: Path, cy_sign: int, p: float) -> None:
    path = tagged.write_project(tmp_path, tagged.fly(tagged.tag(1.009, cy_sign, p), 5))
    said = CliRunner().invoke(app, ["run", str(path), "--json"])
    assert said.exit_code == 0, said.output
    figures = json.loads(said.stdout)
    assert figures["verdict"]["code"] == "usable"
    assert [one["code"] for one in figures["warnings"] if one["severity"] in ("grave", "doubtful")] == []
    assert [one["code"] for one in figures["warnings"]].count("maker-tag") == 1
    (camera,) = read_result(path.parent / "work" / "calibration").cameras.values()
    assert off(camera) == []
    # Who stated the prior is kept with the result.
    assert camera.stated_by == "DewarpData of its maker"
