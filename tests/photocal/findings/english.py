"""What findings say, for tests."""

from __future__ import annotations

from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_text, plain


def english(finding: Finding) -> str:
    """The English sentence without typographic minus signs."""
    return finding_text(finding, catalogue("en"), plain).replace("\u2212", "-")
