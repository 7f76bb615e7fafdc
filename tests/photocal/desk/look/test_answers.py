"""What Look answers over the wire: refusals in words, tiles of the project alone, and leaving out."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
import rasterio  # type: ignore[import-untyped]
from PIL import Image

from photocal.block.project import read_project
from photocal.measurement.marks import read_marks
from tests.photocal.desk.client import Client, opened
from tests.photocal.desk.look.surveys import GROSS_IMAGE, GROSS_POINT, small, with_control
from tests.photocal.measurement.site import flight

MARK = {"image": GROSS_IMAGE, "point": GROSS_POINT}


@pytest.fixture
def client(finished: Path, tmp_path: Path) -> Iterator[Client]:
    with opened(finished, tmp_path / "cache") as asked:
        yield asked


def test_before_a_run_it_says_so(tmp_path: Path) -> None:
    with opened(small(tmp_path / "site"), tmp_path / "cache") as client:
        answer = client.get("/api/look")
        assert answer.status == 404
        assert "run the project first" in answer.json["error"]


def test_every_view_answers(client: Client) -> None:
    overview = client.get("/api/look").json
    assert overview["pictures"] == {f"p{k}.png": True for k in range(1, 9)}
    assert overview["left_out"] == {"entries": [], "waiting": False}
    assert client.get("/api/look/ties.bin").headers["content-type"] == "application/octet-stream"
    assert len(client.get("/api/look/tie-names").json) == overview["ties"]
    assert client.get("/api/look/plots").json["cameras"].keys() == {"cam"}
    assert client.get("/api/look/findings?language=pt-BR").json["lines"]


def test_an_orthophoto_lies_beneath_the_map(client: Client, finished: Path) -> None:
    """Its cells are where rasterio has put them; terrain models, links and other systems are not it."""
    assert client.get("/api/look").json["ground"] is None
    assert client.get("/api/look/ground/0/0/0").status == 404
    wide, high, cell = 1300, 700, 0.05
    place = rasterio.Affine(cell, 0.0, -30.0, 0.0, -cell, 17.0)
    shape = {"driver": "GTiff", "width": wide, "height": high, "transform": place}
    seen = np.zeros((3, high, wide), np.uint8)
    seen[0, :, 600:], seen[1, 600:] = 200, 100
    (finished / "products").mkdir()
    with rasterio.open(
        finished / "products" / "ortho.tif", "w", count=3, dtype="uint8", nodata=0, **shape
    ) as made:
        made.write(seen)
    with rasterio.open(finished / "dtm.tif", "w", count=1, dtype="float32", **shape) as terrain:
        terrain.write(np.ones((1, high, wide), np.float32))
    with rasterio.open(finished / "far.tif", "w", count=3, dtype="uint8", crs="EPSG:31982", **shape) as far:
        far.write(seen)
    (finished / "link.tif").symlink_to("/etc/passwd")
    told = client.get("/api/look").json["ground"]
    assert (told["name"], told["corner"], told["cell_m"]) == ("products/ortho.tif", [-30.0, 17.0], cell)
    assert (told["size"], told["levels"]) == ([wide, high], 2)

    def tile(*place: int) -> Image.Image:
        return Image.open(BytesIO(client.get("/api/look/ground/{}/{}/{}".format(*place)).body))

    fine, coarse = tile(0, 1, 1), tile(2, 0, 0)
    assert fine.size == coarse.size == (512, 512)
    # Cell (600, 600) is pixel (88, 88) of the second tile each way, and (150, 150) of the coarsest.
    assert [fine.getpixel(at) for at in ((88, 88), (88, 87), (87, 87))] == [
        (200, 100, 0, 255),
        (200, 0, 0, 255),
        (0, 0, 0, 0),
    ]
    assert coarse.getpixel((151, 151)) == (200, 100, 0, 255)
    # Beyond its edge it is clear.
    assert coarse.getpixel((330, 10))[3] == 0  # type: ignore[index]
    for wrong in ((3, 0, 0), (0, 3, 0), (0, 0, 2)):
        assert client.get("/api/look/ground/{}/{}/{}".format(*wrong)).status == 404


def test_tiles_are_those_of_the_pictures_and_of_nothing_else(client: Client, finished: Path) -> None:
    whole = Image.open(BytesIO(client.get("/api/tiles/p1.png/0/0/0").body))
    assert whole.size == (480, 360)
    (finished / "images" / "link.png").symlink_to("/etc/passwd")
    for name in (
        "../project.toml",
        "..%2Fproject.toml",
        "%2Fetc%2Fpasswd",
        "project.toml",
        "none.png",
        "link.png",
    ):
        answer = client.get(f"/api/tiles/{name}/0/0/0")
        assert answer.status == 404, name
        assert b"root:" not in answer.body


@pytest.mark.parametrize(
    ("entry", "word"),
    [
        ({**MARK, "reason": ""}, "reason"),
        (MARK, "reason"),
        ({"reason": "why"}, "name an image"),
        ({"point": "P99", "reason": "why"}, "not in the block"),
        ({**MARK, "reason": "two\nlines"}, "not printed"),
        ({**MARK, "reason": "why", "more": 1}, "more"),
    ],
)
def test_what_cannot_be_left_out_is_refused_and_nothing_is_written(
    client: Client, finished: Path, entry: dict[str, str], word: str
) -> None:
    before = (finished / "project.toml").read_bytes()
    answer = client.post("/api/look/leave-out", entry)
    assert answer.status == 422
    assert word in answer.json["error"]
    assert (finished / "project.toml").read_bytes() == before


def test_leaving_out_waits_for_a_run_and_can_be_taken_back(client: Client, finished: Path) -> None:
    entry = {**MARK, "reason": "wrong corner"}
    assert client.post("/api/look/leave-out", entry).json == {"entries": [entry], "waiting": True}
    (kept,) = read_project(finished).contents.leave_out
    assert kept.reason == "wrong corner"
    assert client.post("/api/look/take-back", entry).json == {"entries": [], "waiting": False}
    assert client.post("/api/look/take-back", entry).status == 422


@pytest.mark.parametrize("name", ["none", "<img src=x onerror=alert(1)>", "../p1.png"])
def test_what_takes_no_part_is_refused_in_words(client: Client, name: str) -> None:
    for kind in ("picture", "point"):
        answer = client.get(f"/api/look/{kind}?name={quote(name)}")
        assert answer.status == 404
        assert answer.headers["content-type"].startswith("application/json")
        assert "is not used" in answer.json["error"]


def test_points_are_predicted_and_marked_in_the_same_pictures(finished: Path, tmp_path: Path) -> None:
    places = with_control(finished)
    site = flight()
    with opened(finished, tmp_path / "cache") as client:
        assert client.get("/api/look").json["marking"] is True
        seen = {one["name"]: one for one in client.get("/api/mark/images?point=P3").json["images"]}
        k = max(range(8), key=lambda k: seen[site.names[k]].get("probability", 0.0))
        truth = site.views.project(np.array([k]), np.array([[*places["P3"], 0.0]]))[0]
        there = seen[site.names[k]]
        assert [there["x"], there["y"]] == pytest.approx(truth, abs=3.0)
        click = {"image": site.names[k], "point": "P3", "x": there["x"], "y": there["y"]}
        assert client.post("/api/mark/mark", click).json["snapped"] == "hourglass"
        (mark,) = client.get("/api/mark/state").json["marks"]
        assert [mark["x"], mark["y"]] == pytest.approx(truth, abs=0.3)
    (kept,) = read_marks(finished / "marks.csv")
    assert (kept.image, kept.point) == (site.names[k], "P3")
