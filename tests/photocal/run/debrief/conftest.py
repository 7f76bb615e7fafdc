"""A flight of ten small pictures with its logs, simulated once for the tests of the debrief."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image, ImageFilter

from acquire.simulate.world.configuration import read_configuration
from tests.simulated import PLANS, import_log, simulate

SIZE, FOCAL = (640, 480), 471.4
LENS = {"size_px": SIZE, "pitch_mm": 0.01872, "fx": FOCAL, "fy": FOCAL, "cx": 321.4, "cy": 238.1}

# EXIF: the table of the exposure, and tags in it.
EXIF = 0x8769
FOCAL_MM, SERIAL, TAKEN, BOTH = 0x920A, 0xA431, 0x9003, 0x9004


@pytest.fixture(scope="package", autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What is kept of pictures and pairs is kept for these tests alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="package")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Site of a flight of ten pictures in two strips."""
    return fly(tmp_path_factory.mktemp("flight"))


def fly(folder: Path, **changed: object) -> Path:
    """Simulate the flight and import its log."""
    plan = PLANS / "small.toml"
    known = read_configuration(plan).camera.model_dump(exclude_unset=True)
    site = simulate(folder, plan, **{"camera": {**known, **LENS}, **changed})
    import_log(site)
    return site


def edited(
    path: Path, change: Callable[[Image.Image], Image.Image], exif: dict[int, Any] | None = None
) -> None:
    """Write a picture again with other pixels or tags."""
    with Image.open(path) as image:
        tags, xmp = image.getexif(), image.info.get("xmp", b"")
        made = change(image.convert("RGB"))
    tags.get_ifd(EXIF).update(exif or {})
    # Copies of a flight may share their files.
    path.unlink()
    made.save(path, "JPEG", quality=92, exif=tags, xmp=xmp)


def smeared(image: Image.Image) -> Image.Image:
    """Moved by four pixels while the shutter was open."""
    return image.filter(ImageFilter.Kernel((5, 5), [0] * 10 + [1] * 5 + [0] * 10))


def names(site: Path) -> list[Path]:
    return sorted((site / "images").iterdir())
