"""The first tile of a 50-megapixel JPEG: read, decoded, cut and sent, with nothing kept from before."""

from __future__ import annotations

import urllib.request
from itertools import count
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from photocal.base.web import Address, serving
from photocal.desk.standing import marking_application
from photocal.measurement.marking.store import MarkStore, scene_of_folder
from photocal.measurement.marking.tiles import coarsest_level

WIDTH, HEIGHT = 8660, 5773


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A colour picture with detail at all scales, as large a file as a drone camera writes."""
    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(0)
    picture = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    for side in (2, 8, 64):
        noise = rng.normal(0, 25, (HEIGHT // side + 2, WIDTH // side + 2, 3)).astype(np.float32)
        picture += cv2.resize(noise, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)
    Image.fromarray(np.clip(picture + 128, 0, 255).astype(np.uint8)).save(folder / "a.jpg", quality=90)
    return folder


@pytest.mark.parametrize("which", ["overview", "full scale"])
def test_first_tile(pictures: Path, tmp_path: Path, benchmark: pytest.FixtureRequest, which: str) -> None:
    scene = scene_of_folder(pictures, None, None)
    level = coarsest_level(scene.pictures["a.jpg"].size_px) if which == "overview" else 0
    caches = count()

    def fresh() -> tuple[tuple[str], dict[str, object]]:
        cache = tmp_path / str(next(caches))
        app = marking_application(scene, MarkStore(tmp_path / "marks.csv"), cache)
        server = serving(app, Address("127.0.0.1", 0))
        servers.append(server)
        return (server.__enter__(),), {}

    def ask(url: str) -> bytes:
        with urllib.request.urlopen(f"{url}api/tiles/a.jpg/{level}/0/0") as answer:  # noqa: S310
            return bytes(answer.read())

    servers: list[object] = []
    benchmark.pedantic(ask, setup=fresh, rounds=5)  # type: ignore[attr-defined]
    for server in servers:
        server.__exit__(None, None, None)  # type: ignore[attr-defined]
    benchmark.extra_info["megapixels"] = WIDTH * HEIGHT / 1e6  # type: ignore[attr-defined]
