"""What harms a block is never silently usable: control kilometres off, gross rays, a point or its sigmas.

The flights are those of `tests.independent`, which shares no code with the adjustment.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

import photocal
from photocal.analysis.georeferencing.output import to_json
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.commands.cli import app
from tests.evidence.judging import fly
from tests.independent.faults import BASE, CLEAN, table
from tests.independent.flights import Design, Errors

ALONE = next(design for design in CLEAN if design.name == "control alone")
FAULTS = {fault.name: fault for fault in table()}


@pytest.mark.parametrize(
    ("design", "off_m"),
    [(BASE, (5000.0, 0.0, 0.0)), (BASE, (0.0, 0.0, 3000.0)), (ALONE, (0.0, 60_000.0, 0.0))],
)
def test_control_kilometres_off_is_named_first(
    tmp_path: Path, design: Design, off_m: tuple[float, float, float]
) -> None:
    """One digit too many: the refusal says which point, and so does the analysis, with its error."""
    flown = fly(tmp_path / "block", design, Errors(control=((2, off_m),)), 1)
    block = photocal.read_block(flown.folder)
    with pytest.raises((IllPosedError, NotConvergedError)) as refused:
        photocal.adjust(block)
    assert refused.value.remedy.startswith("first correct or leave out co2:")
    first = photocal.analyse(block).findings[0]
    assert (first.code, first.severity, first.subject) == ("control-mistyped", "grave", "co2")
    numbers = [str(number).split() for number in first.figures["numbers"]]
    # Computed minus given, within 4 of the standard deviations that stand behind it.
    for (_, corrected, _, sigma, *_), off in zip(numbers, off_m, strict=True):
        assert abs(float(corrected) + off) < 4.0 * float(sigma) + 0.001


def test_a_block_that_no_adjustment_ends_with_is_analysed_by_command(tmp_path: Path) -> None:
    """Two control points exchanged: `adjust` writes no run, and `analyse` says a verdict that names them."""
    flown = fly(tmp_path / "block", BASE, Errors(swapped=(0, 1)), 3)
    run, cli = tmp_path / "run", CliRunner()
    adjusted = cli.invoke(app, ["adjust", str(flown.folder), "-o", str(run)])
    assert isinstance(adjusted.exception, IllPosedError | NotConvergedError)
    assert not run.exists()
    for words in ([str(flown.folder)], [str(run), "--block", str(flown.folder)]):
        said = cli.invoke(app, ["analyse", *words, "--json"])
        assert said.exit_code == 0, said.output
        verdict = json.loads(said.stdout)["verdict"]
        assert verdict["code"] == "not-usable"
        assert verdict["block"] == "no"
        assert "co0" in verdict["said"][0]
        assert "co1" in verdict["said"][0]
        assert (f"{run} has no result of an adjustment" in said.stderr) is ("--block" in words)


def test_residuals_far_above_their_sigmas_are_never_a_mere_reservation(tmp_path: Path) -> None:
    """Gross rays left in the block, 3.0 times its sigmas: four of twelve check points are 5 to 15 cm off."""
    fault = FAULTS["2 % of rays 20 times worse"]
    flown = fly(tmp_path / "block", fault.design, fault.errors, 2)
    checked = to_json(photocal.check(photocal.read_block(flown.folder)))
    assert checked["verdict"]["code"] == "not-usable"
    assert "gross errors" in checked["verdict"]["said"][0]
    # Below 1.5 times it is one: noise a quarter worse than stated.
    flown = fly(tmp_path / "worse", replace(BASE, rays_worse=1.25), Errors(), 2)
    checked = to_json(photocal.check(photocal.read_block(flown.folder)))
    assert checked["verdict"]["code"] == "usable-with-reservations"


def test_a_point_or_all_sigmas_is_a_reservation_that_names_the_point(tmp_path: Path) -> None:
    """Ten centimetres in plane, among six points: neither is determined, and both are said."""
    fault = FAULTS["one of 6 control points, 10 cm in plane"]
    flown = fly(tmp_path / "block", fault.design, fault.errors, 2)
    verdict = to_json(photocal.check(photocal.read_block(flown.folder)))["verdict"]
    assert verdict["code"] == "usable-with-reservations"
    assert "Survey co1 again" in verdict["paragraph"]
    told = float(verdict["paragraph"].partition("an error of ")[2].split()[0])
    # The point is 0.10 m off, and what is surveyed and predicted scatters by some centimetres.
    assert abs(told - 0.10) < 0.05
