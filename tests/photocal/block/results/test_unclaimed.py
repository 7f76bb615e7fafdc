"""Sigmas that are assumed, or come from the residuals, test nothing: every outlet says so."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

import photocal
from photocal.block.options import Wanted
from photocal.block.results.adjusted import adjust_network
from photocal.findings.finding import of_global_test
from tests.evidence.judging import fly
from tests.independent.flights import Design, Errors


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> photocal.Block:
    folder = tmp_path_factory.mktemp("flown") / "block"
    return photocal.read_block(fly(folder, Design("small", images=12, per_image=40), Errors(), 0).folder)


def outlets(result: photocal.Result) -> tuple[str, str, str]:
    accepted = None if result.global_test is None else result.global_test.accepted
    tested = of_global_test(result.chi_squared, result.degrees_of_freedom, accepted)
    return repr(result), result._repr_html_(), tested.severity


def test_stated_sigmas_are_tested(block: photocal.Block) -> None:
    text, page, severity = outlets(photocal.adjust(block))
    assert "accepted" in text
    assert "global test accepted" in page
    assert severity == "passed"


@pytest.mark.parametrize("how", ["assumed", "components"])
def test_no_outlet_claims_a_test_of_sigmas_from_the_residuals(block: photocal.Block, how: str) -> None:
    if how == "assumed":
        result = photocal.adjust(replace(block, global_test=(0.95, "none")))
    else:
        result = adjust_network(block, wanted=Wanted(components=True))
    assert result.global_test is None
    text, page, severity = outlets(result)
    assert not re.search("accepted|REJECTED", text + page)
    assert "not claimed" in text
    assert "not claimed" in page
    assert severity == "untested"
