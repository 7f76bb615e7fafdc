"""What the page's server answers, and what it refuses: other files above all."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.base.web import Address, serving
from photocal.block.project import read_project
from photocal.desk.standing import marking_application
from photocal.measurement.marking.store import MarkStore, scene_of_folder, scene_of_project
from tests.photocal.conftest import Answer
from tests.photocal.measurement.marking.conftest import Survey

Ask = Callable[..., tuple[int, Any]]


@pytest.fixture
def ask(survey: Survey) -> Iterator[Ask]:
    """Ask the server: path, and what is posted."""
    (survey.folder / "images" / "zero.jpg").write_bytes(b"")
    (survey.folder / "secret.png").write_bytes((survey.folder / "images" / "p1.png").read_bytes())
    (survey.folder / "images" / "link.png").symlink_to(survey.folder / "secret.png")
    scene, path = scene_of_project(read_project(survey.file), None)
    app = marking_application(scene, MarkStore(path), survey.folder / "cache")
    with serving(app, Address("127.0.0.1", 0)) as url:

        def give(path: str, content: object = None, kind: str = "application/json") -> tuple[int, Any]:
            body = (
                None
                if content is None
                else content
                if isinstance(content, bytes)
                else json.dumps(content).encode()
            )
            request = urllib.request.Request(url + path.lstrip("/"), body, {"content-type": kind})  # noqa: S310
            try:
                with urllib.request.urlopen(request) as answer:  # noqa: S310
                    got = answer.read()
                    return answer.status, got if "tiles/" in path else json.loads(got)
            except urllib.error.HTTPError as refusal:
                text = refusal.read()
                return refusal.code, json.loads(text)["error"] if text.startswith(b"{") else text.decode()

        yield give


@pytest.mark.parametrize(
    "name",
    [
        "../secret.png",
        "..%2Fsecret.png",
        "%2e%2e%2fsecret.png",
        "%2Fetc%2Fpasswd",
        "..%5Csecret.png",
        "p1.png%00.jpg",
        "",
    ],
)
def test_no_other_file_is_given(ask: Ask, name: str) -> None:
    status, _ = ask(f"/api/tiles/{name}/0/0/0")
    assert status == 404
    status, refused = ask("/api/mark/mark", {"image": name, "point": "P1", "x": 5, "y": 5})
    assert (status, "not an image of this project" in refused) == (404, True)


def test_links_out_of_the_folder_and_bad_pictures_are_named(ask: Ask) -> None:
    reasons = {own["name"]: own["reason"] for own in ask("/api/mark/project")[1]["images"]}
    assert reasons["link.png"] == "is a link to a place outside of the folder"
    assert reasons["zero.jpg"] == "is empty (0 bytes)"
    assert reasons["p1.png"] == ""
    for name in ("link.png", "zero.jpg"):
        assert ask(f"/api/tiles/{name}/0/0/0") == (404, f"{name}: {reasons[name]}; choose another picture")
    assert ask("/api/tiles/p1.png/0/0/0")[0] == 200


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ({"image": "p1.png", "point": "P1", "x": 1e9, "y": 5}, "outside of the image"),
        ({"image": "p1.png", "point": "P99", "x": 5, "y": 5}, "not in the table of points"),
        ({"image": "p1.png", "point": "P1\n", "x": 5, "y": 5}, "point"),
        ({"image": "p1.png", "point": "P1", "x": "5", "y": 5}, "x: Input should be a valid number"),
        ({"image": "p1.png", "point": "P1", "x": 5}, "y: Field required"),
        ({"image": "p1.png", "point": "P1", "x": 5, "y": 5, "path": "/etc"}, "path: Extra inputs"),
        ({"image": "p1.png", "point": "P1", "x": 5, "y": 5, "reach": 1e6}, "reach"),
        (b'{"image": "p1.png", "point": "P1", "x": NaN, "y": 5}', "x"),
        (b"{", "Invalid JSON"),
        (b"x" * 20_000, "too long"),
    ],
)
def test_impossible_marks_are_refused(ask: Ask, survey: Survey, content: object, why: str) -> None:
    status, refused = ask("/api/mark/mark", content)
    assert status == 422
    assert why in refused
    assert not (survey.folder / "marks.csv").exists()


def test_forms_of_other_sites_do_nothing(ask: Ask, survey: Survey) -> None:
    content = {"image": "p1.png", "point": "P1", "x": 5, "y": 5}
    assert ask("/api/mark/mark", content, "text/plain")[0] == 422
    assert ask("/api/mark/mark", content, "application/x-www-form-urlencoded")[0] == 422
    assert not (survey.folder / "marks.csv").exists()


def test_images_come_by_how_surely_they_show_the_point(ask: Ask, survey: Survey) -> None:
    for point in ("P1", "P5", "P10"):
        found = ask(f"/api/mark/images?point={point}")[1]["images"]
        chances = [own["probability"] for own in found]
        assert chances == sorted(chances, reverse=True)
        for own in found:
            off = np.subtract((own["x"], own["y"]), survey.truth(own["name"], point))
            # Ellipses of 95 percent: hardly ever twice as far.
            assert np.hypot(*off) < 2 * own["ellipse"]["major"]
    assert "ellipse" not in ask("/api/mark/images?point=nothing")[1]["images"][0]


def test_an_adjustment_without_marks_says_what_is_missing(ask: Ask) -> None:
    status, refused = ask("/api/mark/adjust", {})
    assert (status, refused) == (
        422,
        "no image has enough marks for an adjustment; mark control points in more images",
    )


def test_a_folder_without_a_project_takes_any_name(survey: Survey) -> None:
    scene = scene_of_folder(survey.folder / "images", None, None)
    path = survey.folder / "mine.csv"
    app = marking_application(scene, MarkStore(path), survey.folder / "cache")
    with serving(app, Address("127.0.0.1", 0)) as url:
        body = json.dumps(
            {"image": "p2.png", "point": "corner 7", "x": 30.5, "y": 40.25, "kinds": []}
        ).encode()
        request = urllib.request.Request(f"{url}api/mark/mark", body, {"content-type": "application/json"})  # noqa: S310
        urllib.request.urlopen(request).close()  # noqa: S310
    assert path.read_text() == "image,point,x,y,sx,sy\np2.png,corner 7,30.5000,40.2500,1.0000,1.0000\n"


def test_the_command_says_what_is_missing(
    photocal: Callable[..., Answer], survey: Survey, tmp_path: Path
) -> None:
    told = photocal("mark", survey.file, "--json")
    assert json.loads(told.out)["points"]["P10"] == 0
    pictures = survey.folder / "images"
    for arguments, code, why in (
        ((), 5, "give PROJECT.toml or --images FOLDER"),
        (("--images", pictures), 5, "give -o marks.csv"),
        ((survey.file, "-o", "x.csv"), 5, "a project names its own points and marks"),
        (
            ("--images", pictures, "-o", tmp_path / "m.csv", "--run", tmp_path),
            3,
            "has no result.json; give the folder that `photocal adjust` wrote",
        ),
        ((survey.file, "--address", "here"), 5, "is not of the form HOST:PORT"),
    ):
        told = photocal("mark", *arguments)
        assert told.code == code, told
        assert why in told.err
