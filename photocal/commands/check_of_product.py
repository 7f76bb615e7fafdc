"""`photocal check` of products: discrepancies, orthomosaics, terrain models."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from acquire.console import answer

if TYPE_CHECKING:
    from photocal.accuracy.discrepancies import Discrepancies
    from photocal.accuracy.standard import Question, Standard
    from photocal.products.product_check import ProductCheck


def judge_product(
    found: Discrepancies | ProductCheck,
    path: Path,
    standards: tuple[Standard, ...],
    question: Question,
    figures: Path | None,
    geopackage: Path | None,
    crs: str | None,
    *,
    as_json: bool,
) -> None:
    """Judge a table of discrepancies, or what an orthomosaic and a terrain model say at the check points."""
    from photocal.accuracy.as_json import finite, to_json
    from photocal.accuracy.as_text import to_text
    from photocal.accuracy.assessment import assess
    from photocal.accuracy.discrepancies import Discrepancies

    more: dict[str, object] = {}
    remarks: tuple[str, ...] = ()
    if not isinstance(found, Discrepancies):
        likeness, remarks = [finite(v) for v in found.likeness.tolist()], found.remarks
        more, found = {"likeness": likeness, "remarks": list(remarks)}, found.discrepancies
    result = assess(found, standards, question)
    _files(result.discrepancies, path, figures, geopackage, crs)
    answer(as_json, lambda: to_json(result) | more, lambda: "\n".join([to_text(result), *remarks]))


def _files(
    found: Discrepancies, path: Path, figures: Path | None, geopackage: Path | None, crs: str | None
) -> None:
    """Residual map, histograms and GeoPackage of a product, where they are asked for."""
    if figures is not None:
        from photocal.accuracy.figures import write_figures

        write_figures(found, figures)
    if geopackage is not None:
        from photocal.accuracy.geopackage import reference_system, write_geopackage

        write_geopackage(geopackage, (("check", found),), reference_system(crs), changed_utc(path))


def changed_utc(source: Path) -> str:
    """Time of the input, not of the clock: the same input gives the same file."""
    from datetime import UTC, datetime

    table = source / "points.csv" if source.is_dir() else source
    changed = datetime.fromtimestamp(table.stat().st_mtime, UTC)
    return f"{changed:%Y-%m-%dT%H:%M:%S}.000Z"
