"""What a search found: worst first, each with its figure and its effect."""

from __future__ import annotations

from photocal.analysis.systematic_errors.camera_findings import (
    of_bias,
    of_jackknife,
    of_round,
    of_shift,
    of_sigma,
    of_significance,
    of_strips,
)
from photocal.analysis.systematic_errors.head_findings import of_heads
from photocal.analysis.systematic_errors.image_findings import of_groups, of_images, of_maps, of_stated
from photocal.analysis.systematic_errors.search import Search
from photocal.findings.finding import Finding


def findings(search: Search) -> tuple[Finding, ...]:
    """Turn a search into a list."""
    listed = [of_round(one) for one in search.rounds]
    listed += of_shift(search)
    listed += of_strips(search)
    listed += of_sigma(search)
    listed += of_bias(search)
    listed += of_significance(search)
    listed += of_jackknife(search)
    listed += of_stated(search)
    listed += of_groups(search)
    listed += of_heads(search.last)
    listed += of_images(search)
    listed += of_maps(search)
    return tuple(sorted(listed, key=lambda one: one.small))
