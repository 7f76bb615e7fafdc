"""Marks without coordinates of their points, as other programs write them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from drivers.errors import InputMalformedError
from photocal.exchange.parts import Mark, require_unique
from photocal.exchange.source import Line, number, read_lines
from photocal.measurement.control_files import metashape_marks, read_control_marks
from photocal.measurement.marks import BY_HAND_PX, read_marks

# Words that head the columns of such tables, in the order in which tables without a head have them.
_HEADS = (
    ("image", ("image", "image_name", "imagename", "image_label", "camera", "camera_label", "photo")),
    ("point", ("point", "gcp", "gcp_name", "gcp_label", "marker", "marker_label", "label")),
    ("x", ("x", "u", "image_u", "image_x", "x_px")),
    ("y", ("y", "v", "image_v", "image_y", "y_px")),
)
# Of our own tables, whose upper-left pixel has its centre at (0, 0).
_OWN = ("image", "point", "x", "y")
# In all others the corner of that pixel is (0, 0).
_HALF = 0.5


def read_any_marks(path: Path, sizes: Mapping[str, tuple[int, int]]) -> tuple[Mark, ...]:
    """Read marks of ours, of Pix4D, of Metashape (XML or table), gcp_list.txt or OpenSfM's control.

    A table of Pix4D has image, point, x, y and no head; its fifth column is the zoom in one program and an
    accuracy in another, and is not used. Tables of Metashape's scripts have a head and the same order. In
    both the upper-left corner of the upper-left pixel is (0, 0). A table with the head of our marks.csv is
    taken as ours.
    """
    kind = path.suffix.lower()
    if kind == ".xml":
        marks = metashape_marks(path)
    elif kind == ".json":
        marks = read_control_marks(path, (1.0, 1.0), sizes).marks
    else:
        marks = _text(path)
    if not marks:
        raise InputMalformedError("has no marks", where=path, remedy="is it the right file?")
    marks = named_after(marks, sizes)
    require_unique([f"{mark.point} in image {mark.image}" for mark in marks], "point", path)
    return marks


def named_after(marks: Iterable[Mark], images: Iterable[str]) -> tuple[Mark, ...]:
    """Give marks the names of image files: other programs leave out endings, or name folders, too."""
    names = set(images)
    stems: dict[str, list[str]] = {}
    for name in names:
        stems.setdefault(Path(name).stem.casefold(), []).append(name)

    def named(image: str) -> str:
        last = image.replace("\\", "/").rsplit("/", 1)[-1]
        alike = stems.get(last.casefold(), []) or stems.get(Path(last).stem.casefold(), [])
        return last if last in names else alike[0] if len(alike) == 1 else image

    return tuple(replace(mark, image=named(mark.image)) for mark in marks)


def _text(path: Path) -> tuple[Mark, ...]:
    lines = read_lines(path)
    first = lines[0].text.strip() if lines else ""
    delimiter = next((one for one in ("\t", ";", ",") if one in first), None)
    if delimiter is None:
        # Blanks between coordinates, and the system in the first line.
        return read_control_marks(path, (1.0, 1.0), {}).marks
    head = [cell.strip().strip('"').lower().replace(" ", "_") for cell in first.split(delimiter)]
    if tuple(head[:4]) == _OWN:
        return read_marks(path)
    order = _order(head, path)
    body = lines if order is None else lines[1:]
    return tuple(_mark(line, delimiter, order or (0, 1, 2, 3)) for line in body)


def _order(head: Sequence[str], path: Path) -> tuple[int, ...] | None:
    """Where image, point, x and y stand in a head; None for a first row that is a mark."""
    if len(head) >= 4 and _is_number(head[2]) and _is_number(head[3]):
        return None
    order = []
    for what, words in _HEADS:
        here = [k for k, cell in enumerate(head) if cell in words]
        if len(here) != 1:
            raise InputMalformedError(
                f"its head {', '.join(head)!r} does not say which column is the {what}",
                where=path,
                remedy="head them image_name,gcp_name,image_u,image_v, or leave the head out",
            )
        order.append(here[0])
    return tuple(order)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _mark(line: Line, delimiter: str, order: Sequence[int]) -> Mark:
    cells = [cell.strip().strip('"') for cell in line.text.split(delimiter)]
    if len(cells) <= max(order) or not cells[order[0]] or not cells[order[1]]:
        raise InputMalformedError(
            f"has {len(cells)} cells where image, point, x, y were expected", where=line.place
        )
    if delimiter != ",":
        cells = [cell.replace(",", ".") for cell in cells]
    x, y = (number(cells[k], line.place, "mark") - _HALF for k in order[2:])
    return Mark(cells[order[0]], cells[order[1]], x, y, (BY_HAND_PX, BY_HAND_PX), line.place)
