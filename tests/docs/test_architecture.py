"""docs/architecture.md: arrows go one way, every room has its place, the figure is that of the sources."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.architecture_figure import ABOVE_ALL, BOXES, FIGURE, SHARED, arrows, boxes_of_rooms, figure
from tests.docs.rooms import between_modules, between_rooms, circle

PAGE = FIGURE.with_suffix(".md").read_text(encoding="utf-8")


def test_a_circle_is_found() -> None:
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"d"}, "d": {"a"}}) == ["a", "b", "c", "d", "a"]


def test_no_module_imports_itself_by_a_detour() -> None:
    edges = between_modules()
    assert len(edges) > 300
    assert circle(edges) == []


def test_every_room_has_a_place() -> None:
    assert set(between_rooms()) == {*boxes_of_rooms(), *SHARED, ABOVE_ALL}


def test_arrows_point_down() -> None:
    """Also those that the figure leaves out because others imply them."""
    places = boxes_of_rooms()
    turned = [
        f"{room} -> {other}"
        for room, others in between_rooms().items()
        for other in others
        if room in places and other in places and places[room] != places[other]
        and places[room].bottom > places[other].top
    ]  # fmt: skip
    assert turned == []


def test_shared_rooms_import_nothing_above_them() -> None:
    edges = between_rooms()
    for room in SHARED:
        assert edges[room] <= {"drivers", *SHARED}
    assert not any(ABOVE_ALL in others for others in edges.values())


def test_rules_of_the_page() -> None:
    edges = between_rooms()
    assert edges["drivers"] == set()
    assert not any(one.startswith("photocal") for one in edges["acquire.simulate"])
    assert not any(
        o.startswith("photocal") for r, others in edges.items() if r.startswith("acquire") for o in others
    )
    assert edges["photocal.geometry"] <= {"drivers", "photocal.compiled"}
    assert edges["photocal.adjustment"] <= {"drivers", "photocal.compiled", "photocal.geometry"}
    drivers = list((Path(__file__).parents[2] / "drivers").rglob("*.py"))
    opened = [
        path.name
        for path in drivers
        if re.search(r"\bopen\(|\.now\(|time\.time\(|monotonic\(", path.read_text())
    ]
    assert opened == []


def test_figure_is_that_of_the_sources() -> None:
    assert FIGURE.read_text(encoding="utf-8") == figure(), "run `make manual`"


def test_arrows_cross_no_box() -> None:
    """Straight ones at least: the middle of the overlap stays clear of what lies between."""
    for a, b in arrows():
        left, right = max(a.left, b.left), min(a.right, b.right)
        if left < right:
            x = (left + right) / 2
            hit = [c.title for c in BOXES if a.bottom < c.top and c.bottom < b.top and c.left <= x <= c.right]
            assert hit == [], f"{a.title} -> {b.title}"


@pytest.mark.parametrize("step", sorted({box.step for box in BOXES if box.step}))
def test_steps_of_the_page_name_their_rooms(step: str) -> None:
    found = re.search(rf"^{step}\. \*\*(.+?)\.\*\*", PAGE, re.MULTILINE)
    assert found is not None
    for box in BOXES:
        if box.step == step:
            assert any(word in found[1] for word in box.title.split(" · "))
