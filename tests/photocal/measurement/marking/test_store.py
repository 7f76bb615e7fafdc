"""Marks on disk after every change, undone and redone, and beside changes of others."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from photocal.base.errors import InputMalformedError, PhotocalError
from photocal.exchange.parts import Mark
from photocal.measurement.marking.store import MarkStore, scene_of_folder
from photocal.measurement.marks import read_marks


def mark(image: str, point: str, x: float = 1.0, y: float = 2.0) -> Mark:
    return Mark(image, point, x, y, (0.1, 0.2), "")


def on_disk(path: Path) -> list[tuple[str, str, float, float]]:
    return [(m.image, m.point, m.x, m.y) for m in read_marks(path)]


def test_changes_are_on_disk_and_can_be_taken_back(tmp_path: Path) -> None:
    path = tmp_path / "marks.csv"
    store = MarkStore(path)
    assert store.marks == ()
    store.put(mark("a.jpg", "P1"))
    store.put(mark("b, c.jpg", "P1", 3.25, -0.5))
    store.put(mark("a.jpg", "P1", 7.0, 8.0))
    assert on_disk(path) == [("a.jpg", "P1", 7.0, 8.0), ("b, c.jpg", "P1", 3.25, -0.5)]
    assert store.undo() == ("a.jpg", "P1")
    assert on_disk(path)[0] == ("a.jpg", "P1", 1.0, 2.0)
    assert store.undo() == ("b, c.jpg", "P1")
    assert store.undo() == ("a.jpg", "P1")
    assert store.undo() is None
    assert not path.exists()
    for _ in range(3):
        store.redo()
    assert store.redo() is None
    assert on_disk(path) == [("a.jpg", "P1", 7.0, 8.0), ("b, c.jpg", "P1", 3.25, -0.5)]
    store.remove(("a.jpg", "P1"))
    store.undo()
    store.put(mark("d.jpg", "P2"))
    assert store.history == (True, False)
    assert {m.image for m in MarkStore(path).marks} == {"a.jpg", "b, c.jpg", "d.jpg"}
    assert [p.name for p in tmp_path.iterdir()] == ["marks.csv"]


def test_marks_that_somebody_else_writes_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "marks.csv"
    mine, other = MarkStore(path), MarkStore(path)
    mine.put(mark("a.jpg", "P1"))
    other.put(mark("b.jpg", "P2"))
    mine.put(mark("c.jpg", "P3"))
    assert [name for name, *_ in on_disk(path)] == ["a.jpg", "b.jpg", "c.jpg"]
    # What was done before the other's change may not fit it any more.
    assert mine.undo() == ("c.jpg", "P3")
    assert mine.undo() is None


def test_a_mark_that_cannot_be_saved_is_not_there(tmp_path: Path) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    store = MarkStore(folder / "marks.csv")
    store.put(mark("a.jpg", "P1"))
    kept = folder / "marks.csv"
    content = kept.read_bytes()
    kept.unlink()
    kept.mkdir()
    with pytest.raises(PhotocalError) as refusal:
        store.put(mark("b.jpg", "P1"))
    assert "marks.csv" in str(refusal.value)
    kept.rmdir()
    kept.write_bytes(content)
    assert [m.image for m in store.marks] == ["a.jpg"]


def test_a_table_that_is_none_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "marks.csv"
    path.write_text("image,point,x\na,P1,3\n")
    with pytest.raises(InputMalformedError, match="column y is missing"):
        MarkStore(path)
    assert path.read_text() == "image,point,x\na,P1,3\n"


def test_turned_pictures_are_marked_on_the_stored_grid(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.new("L", (300, 200)).save(tmp_path / "a.jpg", exif=exif)
    own = scene_of_folder(tmp_path, None, None).pictures["a.jpg"]
    assert (own.size_px, own.turn_deg) == ((300, 200), 90)
