"""docs/architecture.md: arrows go one way, every room has its sentence, the figure is that of the sources."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.architecture_figure import FIGURE, STEPS, boxes, figure, rooms
from tests.docs.rooms import between_modules, between_rooms, circle

PAGE = FIGURE.with_suffix(".md").read_text(encoding="utf-8")
GROUND = "photocal.base"


def test_a_circle_is_found() -> None:
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"d"}, "d": {"a"}}) == ["a", "b", "c", "d", "a"]


def test_no_module_imports_itself_by_a_detour() -> None:
    edges = between_modules()
    assert len(edges) > 300
    assert circle(edges) == []


def test_no_room_imports_itself_by_a_detour() -> None:
    assert circle(rooms()) == []


def test_every_room_has_a_sentence() -> None:
    assert [room for room, box in boxes().items() if not box.sentence] == []


def test_one_room_stands_on_the_ground() -> None:
    assert [room for room, others in rooms().items() if not others] == [GROUND]


def test_drivers_and_acquire_take_only_the_ground_of_photocal() -> None:
    taken = {
        other
        for room, others in between_rooms().items()
        if not room.startswith("photocal")
        for other in others
        if other.startswith("photocal")
    }
    assert taken == {GROUND}


def test_rules_of_the_page() -> None:
    edges = between_rooms()
    assert edges["drivers"] == {GROUND}
    assert edges["acquire.simulate"] == {"drivers", GROUND}
    assert edges["photocal.geometry"] == {GROUND}
    assert edges["photocal.adjustment"] == {GROUND, "photocal.geometry"}
    assert not any("photocal.demo" in others for others in edges.values())
    drivers = list((Path(__file__).parents[2] / "drivers").rglob("*.py"))
    opened = [
        path.name
        for path in drivers
        if re.search(r"\bopen\(|\.now\(|time\.time\(|monotonic\(", path.read_text())
    ]
    assert opened == []


def test_figure_is_that_of_the_sources() -> None:
    assert FIGURE.read_text(encoding="utf-8") == figure(), "run `make manual`"


@pytest.mark.parametrize("step", sorted(set(STEPS.values())))
def test_steps_of_the_page_name_their_rooms(step: str) -> None:
    found = re.search(rf"^{step}\. \*\*(.+?)\.\*\*", PAGE, re.MULTILINE)
    assert found is not None
    for room in (room for room, number in STEPS.items() if number == step):
        assert room.rpartition(".")[2] in found[1]
