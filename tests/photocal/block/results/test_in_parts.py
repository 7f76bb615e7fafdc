"""`photocal adjust --parts`: the files of the whole block, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError
from photocal.block.options import PartsOptions
from photocal.block.results import in_parts
from photocal.block.results.in_parts import adjust_block_in_parts
from tests.photocal import blocks
from tests.photocal.conftest import Answer


def test_results_are_those_of_the_whole(photocal: Callable[..., Answer], tmp_path: Path) -> None:
    block = blocks.small(tmp_path / "block")
    whole = photocal("adjust", block, "-o", tmp_path / "whole")
    parts = photocal("adjust", block, "-o", tmp_path / "parts", "--parts", "2", "--workers", "1")
    assert (whole.code, parts.code, parts.err) == (0, 0, "")
    for name in ("images.csv", "points.csv", "residuals.csv"):
        one, other = ((tmp_path / run / name).read_text().splitlines() for run in ("whole", "parts"))
        assert len(one) == len(other) > 1
        for line, expected in zip(other[1:], one[1:], strict=True):
            for value, wanted in zip(line.split(","), expected.split(","), strict=True):
                try:
                    assert float(value) == pytest.approx(float(wanted), rel=1e-6, abs=1e-7)
                except ValueError:
                    assert value == wanted
    first, second = (json.loads((tmp_path / run / "result.json").read_text()) for run in ("whole", "parts"))
    assert second["degrees_of_freedom"] == first["degrees_of_freedom"]
    for name, of_whole in first["cameras"].items():
        of_parts = second["cameras"][name]["parameters"]
        for parameter, given in of_whole["parameters"].items():
            assert of_parts[parameter]["sigma"] == pytest.approx(given["sigma"], rel=1e-6)
    # Nothing is left beside the results.
    assert {path.name for path in tmp_path.iterdir()} == {"block", "whole", "parts"}


def test_options_that_contradict_each_other_are_refused(
    photocal: Callable[..., Answer], tmp_path: Path
) -> None:
    block = blocks.small(tmp_path / "block")
    cases = {
        ("--workers", "2"): "give --parts, too",
        ("--parts", "2", "--workers", "2", "--cluster", "tcp://127.0.0.1:1"): "both given",
        ("--parts", "2", "--snoop", "w"): "--parts goes with no other figures",
        ("--parts", "2", "--cluster", "tcp://127.0.0.1:1"): "no scheduler answers there",
    }
    for options, reason in cases.items():
        told = photocal("adjust", block, "-o", tmp_path / "run", *options)
        assert told.code in (5, 10)
        assert reason in told.err
        assert not (tmp_path / "run").exists()


def test_too_little_memory_is_said_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    block = blocks.small(tmp_path / "block")
    monkeypatch.setattr(in_parts, "available_memory", lambda: 500_000_000)
    with pytest.raises(ConfigurationError, match=r"takes about 0\.[69] GB of memory, 0\.5 GB are free"):
        adjust_block_in_parts(block, tmp_path / "run", PartsOptions(parts=2, workers=1))
    assert not list(tmp_path.glob("run*"))
    assert np.isfinite(adjust_block_in_parts_with(block, tmp_path / "run", monkeypatch))


def adjust_block_in_parts_with(block: Path, output: Path, monkeypatch: pytest.MonkeyPatch) -> float:
    """The same with enough memory."""
    monkeypatch.setattr(in_parts, "available_memory", lambda: 5_000_000_000)
    return adjust_block_in_parts(block, output, PartsOptions(parts=2, workers=1)).chi_squared
