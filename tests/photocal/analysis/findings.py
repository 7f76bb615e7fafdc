"""Findings of the tests in words, and their sizes."""

from __future__ import annotations

from photocal.findings.finding import Finding, Size
from photocal.findings.texts import catalogue, finding_text, plain

ENGLISH = catalogue("en")


def said(finding: Finding) -> str:
    """The sentence without typographic minus signs."""
    return finding_text(finding, ENGLISH, plain).replace("\u2212", "-")


def sized(finding: Finding) -> Size:
    """The size of a finding that has one."""
    assert finding.size is not None
    return finding.size
