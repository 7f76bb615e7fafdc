"""Whether c is as well determined in flight as is wanted, what is lacking, and a continued orientation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError
from photocal.base.operating_system import cache_folder
from photocal.base.progress import quiet
from photocal.block.project import WantedCalibration, read_project
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue
from photocal.measurement.image_file import list_images
from photocal.measurement.match_images import MatchingPlan
from photocal.run.debrief.determined import determined
from photocal.run.debrief.pictures import QUICK, Quick, look, orient_quickly
from photocal.run.debrief.verdict import SO_FAR, Debrief, calibration_text


@pytest.fixture(scope="module")
def plan() -> MatchingPlan:
    return MatchingPlan(cache_folder(), 1, QUICK)


def oriented(site: Path, plan: MatchingPlan, count: int, before: Quick | None = None) -> Quick:
    looks = [look((path, plan)) for path in list_images(site / "images")[:count]]
    facts = [one.facts for one in looks if one.facts is not None]
    return orient_quickly(facts, [one.key for one in looks], (), plan, quiet, before)


@pytest.fixture(scope="module")
def quick(flown: Path, plan: MatchingPlan) -> Quick:
    return oriented(flown, plan, 10)


def lines(quick: Quick, keys: WantedCalibration, language: str, code: str = SO_FAR) -> list[str]:
    made = Debrief(Finding(code, "note"), (), (), None, None, quick, keys)
    return calibration_text(made, catalogue(language))


def test_a_wide_wish_is_reached_and_said_in_both_languages(quick: Quick) -> None:
    keys = WantedCalibration(c_sigma_px=400.0)
    (told,) = determined(quick, keys)
    assert told.wanted == pytest.approx(400.0)
    assert (told.source, told.lacks) == ("project", "")
    (line,) = lines(quick, keys, "en")
    assert line.endswith("wanted ± 400 px (stated in the project): determined, you may land")
    assert lines(quick, keys, "pt-BR")[0].endswith("(declarado no projeto): determinada, pode pousar")
    # After the landing nobody is told to land.
    assert lines(quick, keys, "en", "flight-complete")[0].endswith(": determined")


def test_what_is_not_reached_says_what_to_fly(quick: Quick) -> None:
    """The flight has two strips there and back at one height."""
    keys = WantedCalibration(c_sigma_percent=1e-4)
    (told,) = determined(quick, keys)
    assert told.wanted == pytest.approx(1e-6 * 471.4, rel=0.05)
    assert told.lacks == "crosswise"
    assert lines(quick, keys, "en")[0].endswith("not yet, fly a strip across the others")
    assert lines(quick, keys, "pt-BR")[0].endswith("ainda não, voe uma faixa transversal às demais")
    values = quick.adjusted.solution.exposures.copy()
    values[::2, 2] += np.pi / 2
    crossed = replace(quick.adjusted.solution, exposures=values)
    assert determined(_with(quick, crossed), keys)[0].lacks == "height"
    values = values.copy()
    values[::2, 5] *= 1.5
    both = replace(quick.adjusted.solution, exposures=values)
    assert determined(_with(quick, both), keys)[0].lacks == "more"


def _with(quick: Quick, solution: object) -> Quick:
    return replace(quick, adjusted=replace(quick.adjusted, solution=solution))  # type: ignore[arg-type]


def test_without_a_wish_the_heights_of_the_positions_say_it(quick: Quick) -> None:
    """A third of 3 m over some 30 m would be 3 %: it is never more than 0.5 %."""
    (told,) = determined(quick, WantedCalibration())
    assert told.source == "positions"
    stated = quick.adjusted.block.cameras[0].value("c")
    assert told.wanted == pytest.approx(5e-3 * stated)
    images = quick.adjusted.start.images
    sigma = images.sigma.copy()
    sigma[:, 5] = 0.03
    finely = replace(quick.adjusted.start, images=replace(images, sigma=sigma))
    (told,) = determined(replace(quick, adjusted=replace(quick.adjusted, start=finely)), WantedCalibration())
    assert told.wanted == pytest.approx(1e-3 * stated)


def test_what_rays_do_not_tell_is_not_determined(quick: Quick) -> None:
    entry = {**quick.cameras[0], "released": {**quick.cameras[0]["released"], "credible": False}}
    untold = replace(quick, cameras=[entry])
    keys = WantedCalibration(c_sigma_px=400.0)
    (told,) = determined(untold, keys)
    assert told.c is None
    assert told.lacks
    assert "do not determine c yet" in lines(untold, keys, "en")[0]


def test_continued_it_comes_to_the_same(flown: Path, plan: MatchingPlan, quick: Quick) -> None:
    """Within a tenth of the standard deviation of an orientation from nothing."""
    continued = oriented(flown, plan, 10, oriented(flown, plan, 7))
    assert continued.joined == quick.joined == 10
    (one,), (other,) = ([camera["released"] for camera in found.cameras] for found in (continued, quick))
    assert one["c"] == pytest.approx(other["c"], abs=0.1 * other["sigma"])
    assert one["sigma"] == pytest.approx(other["sigma"], rel=0.05)


def test_one_wish_at_a_time(flown: Path, tmp_path: Path) -> None:
    file = tmp_path / "project.toml"
    text = (flown / "project.toml").read_text(encoding="utf-8")
    file.write_text(text + "\n[calibration]\nc_sigma_px = 2.0\n", encoding="utf-8")
    assert read_project(file).contents.calibration.c_sigma_px == 2.0
    file.write_text(text + "\n[calibration]\nc_sigma_px = 2.0\nc_sigma_percent = 1.0\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="either c_sigma_px or c_sigma_percent"):
        read_project(file)
