"""Marks that do not fit: each by name while they are few, the worst of many with their number."""

from __future__ import annotations

from typing import Any

import pytest

from photocal.findings.texts import catalogue, finding_text, plain
from photocal.measurement.measurement_record import findings_of_marks


def suspects(count: int) -> list[dict[str, Any]]:
    keys = ("image", "point", "residual_px", "in_sigmas")
    return [dict(zip(keys, (f"IMG{k}", f"P{k}", 90.0 - k, 45.0 - k / 2), strict=True)) for k in range(count)]


def test_few_are_each_named() -> None:
    named = [one.subject for one in findings_of_marks((), (), suspects(3), ())]
    assert named == ["P0 (IMG0)", "P1 (IMG1)", "P2 (IMG2)"]


@pytest.mark.parametrize("language", ["en", "pt-BR"])
def test_of_many_the_worst_are_named_once(language: str) -> None:
    (finding,) = findings_of_marks((), (), suspects(241), ())
    text = finding_text(finding, catalogue(language), plain)
    assert all(words in text for words in ("P0", "IMG0", "240", "P3 (IMG3)"))
    assert "P4" not in text
