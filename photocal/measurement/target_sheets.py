"""Target sheets as PDF, true to scale, with a bar to prove it after printing."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence

from drivers.errors import ConfigurationError, OutputError
from photocal.measurement.target_shapes import Disc, Shape, Sheet

PAPERS_MM = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
}
# What printers leave white, and the strip at the foot with the bar and the words.
EDGE_MM, FOOT_MM = 6.0, 22.0
BAR_MM = 100.0
# The sheets do not depend on the day.
_DATE = dt.datetime(2000, 1, 1, tzinfo=dt.UTC)


def sheets_pdf(sheets: Sequence[Sheet], paper: str) -> bytes:
    """Set target sheets, one on a page.

    raises ConfigurationError: when a target does not fit, or the paper is not known.
    raises OutputError.
    """
    import typst

    if paper.lower() not in PAPERS_MM:
        raise ConfigurationError(f"paper {paper!r} is not known", remedy=f"use {', '.join(PAPERS_MM)}")
    source = "\n#pagebreak()\n".join(_page(sheet, paper.lower()) for sheet in sheets)
    head = '#set text(font: "Libertinus Serif", size: 9pt)\n#set page(margin: 0mm)\n'
    compiler = typst.Compiler(font_paths=typst.Fonts(include_system_fonts=False))
    try:
        made = compiler.compile((head + source).encode(), format="pdf", timestamp=_DATE)
    except typst.TypstError as refusal:
        raise OutputError(f"the PDF could not be set ({refusal})", remedy="report this") from None
    if not isinstance(made, bytes):
        raise OutputError("the PDF could not be set (no single file)", remedy="report this")
    return made


def _page(sheet: Sheet, paper: str) -> str:
    width, height = _turned(PAPERS_MM[paper], sheet)
    _require_room(sheet, paper)
    middle = (width / 2, (height - FOOT_MM) / 2)
    foot = height - FOOT_MM
    parts = [f"#set page(width: {width}mm, height: {height}mm)", *(_drawn(s, middle) for s in sheet.shapes)]
    for k in range(int(BAR_MM // 10) + 1):
        long = k % 5 == 0
        parts.append(_line((EDGE_MM + 10 * k, foot + 6 - (4 if long else 2)), (EDGE_MM + 10 * k, foot + 6)))
    parts.append(_line((EDGE_MM, foot + 6), (EDGE_MM + BAR_MM, foot + 6)))
    parts.append(_words(foot + 7.5, f"{BAR_MM:g} mm: print at 100 % and measure this bar"))
    parts.append(_words(foot + 12, f"photocal: {sheet.title}"))
    return "\n".join(parts)


def _turned(size: tuple[float, float], sheet: Sheet) -> tuple[float, float]:
    return (size[1], size[0]) if sheet.size_mm[0] > sheet.size_mm[1] else size


def _require_room(sheet: Sheet, paper: str) -> None:
    needed = [side + 2 * sheet.margin_mm for side in sheet.size_mm]
    fitting = [
        name
        for name, size in PAPERS_MM.items()
        for width, height in [_turned(size, sheet)]
        if needed[0] <= width - 2 * EDGE_MM and needed[1] <= height - FOOT_MM - EDGE_MM
    ]
    if paper not in fitting:
        remedy = f"use --paper {fitting[0]}" if fitting else "make it smaller, or have it printed from parts"
        raise ConfigurationError(
            f"the target needs {needed[0]:g} x {needed[1]:g} mm, more than {paper} has", remedy=remedy
        )


def _drawn(shape: Shape, middle: tuple[float, float]) -> str:
    fill = "black" if shape.black else "white"
    x, y = middle
    if isinstance(shape, Disc):
        r = shape.diameter / 2
        return f"#place(dx: {x - r:.4f}mm, dy: {y - r:.4f}mm, circle(radius: {r:.4f}mm, fill: {fill}))"
    corners = ", ".join(f"({x + a:.4f}mm, {y + b:.4f}mm)" for a, b in shape.corners)
    return f"#place(polygon(fill: {fill}, {corners}))"


def _line(start: tuple[float, float], end: tuple[float, float]) -> str:
    ends = ", ".join(f"{name}: ({x:.3f}mm, {y:.3f}mm)" for name, (x, y) in (("start", start), ("end", end)))
    return f"#place(line({ends}, stroke: 0.2mm))"


def _words(top: float, text: str) -> str:
    plain = text.replace("\\", "").replace('"', "")
    return f'#place(dx: {EDGE_MM}mm, dy: {top:.2f}mm, text("{plain}"))'
