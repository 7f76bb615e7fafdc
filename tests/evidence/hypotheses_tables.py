"""The tables of the study of hypotheses."""

from __future__ import annotations


def page(*parts: object) -> str:
    """The page."""
    return ""
