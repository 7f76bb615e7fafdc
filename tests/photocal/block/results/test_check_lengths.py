"""Known distances that take no part in an adjustment."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path

import numpy as np
import pytest

from photocal.block.folder import read_block
from photocal.block.results.adjusted import adjust_block
from photocal.report.certificate_metadata import read_particulars
from photocal.report.issue import issue
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly


def test_check_lengths_stand_in_the_result_with_the_sigma_of_both_ends_together(tmp_path: Path) -> None:
    block = fly(tmp_path / "block", np.random.default_rng(5), Errors(), Plan(tie=40))
    points = read_block(block).points
    control = [points.names[j] for j in np.flatnonzero(points.of_role("control"))[:3]]
    at = {name: points.values[points.names.index(name)] for name in control}
    known = [float(np.linalg.norm(at[a] - at[b])) for a, b in (control[:2], control[1:])]
    rows = [f"{a},{b},{value},0.002" for (a, b), value in zip((control[:2], control[1:]), known, strict=True)]
    without = adjust_block(block, tmp_path / "without")
    (block / "check_distances.csv").write_text("\n".join(["from,to,value,sigma", *rows]) + "\n")
    found = adjust_block(block, tmp_path / "run")
    assert found.chi_squared == pytest.approx(without.chi_squared, rel=1e-12)
    assert [(one.first, one.second) for one in found.checks.lengths] == [
        tuple(control[:2]),
        tuple(control[1:]),
    ]
    for one, value in zip(found.checks.lengths, known, strict=True):
        ends = [found.points.names.index(name) for name in (one.first, one.second)]
        places = found.points.values[ends]
        assert one.error == pytest.approx(float(np.linalg.norm(places[1] - places[0])) - value, abs=1e-6)
        apart = np.sqrt(sum(np.trace(found.points.covariance[j]) for j in ends))
        assert 0.0 < one.sigma < apart
        assert abs(one.error) < 5 * np.hypot(one.sigma, 0.015 * np.sqrt(2))
    assert "check lengths: 2" in repr(found)
    issue(tmp_path / "run", tmp_path / "c", read_particulars(None, dt.date(2026, 11, 22)))
    page = (tmp_path / "c" / "certificate.html").read_text(encoding="utf-8")
    assert "VDI/VDE 2634" in page
    record = json.loads((tmp_path / "c" / "certificate.json").read_text(encoding="utf-8"))
    assert len(record["result"]["checks"]["lengths"]) == 2
