"""Tiles of large pictures at several scales: made when they are viewed, kept by content.

A pixel of level k covers 2^k by 2^k stored pixels, beginning with those of the upper-left corner. So its
column j has its centre at the stored column 2^k j + (2^k - 1) / 2, in all formats.
"""

import time
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from photocal.base.errors import InputNotFoundError
from photocal.base.files import digest, write_file
from photocal.measurement.features import sweep, touch
from photocal.measurement.image_file import as_eight_bit, as_stored, opened, read_grey

if TYPE_CHECKING:
    from PIL.Image import Image

TILE_PX = 512
# Decoded levels are held until they are this many pixels together, 4 bytes each; one may be larger.
HELD_PX = 80_000_000
# Tiles on disk: about 40 pictures of 50 megapixels viewed all over, for a month.
MOST_BYTES = 2_000_000_000
UNUSED_S = 30 * 86_400.0
_MANY_BITS = ("I;16", "I;16B", "I;16L", "I;16N", "I", "F")


def coarsest_level(size_px: tuple[int, int]) -> int:
    """Give the first level that is one tile."""
    return ((max(size_px) - 1) // TILE_PX).bit_length()


class Tiles:
    """Tiles of pictures, on disk once they were made.

    most_bytes: that tiles of all projects may have on disk together.
    held_px: of decoded levels in memory.
    """

    def __init__(self, cache: Path, most_bytes: int = MOST_BYTES, held_px: int = HELD_PX) -> None:
        self.held_px = held_px
        # Raised whenever tiles of the same content would look different.
        version = 1
        self._folder, self._most_bytes = cache / f"tiles{version}", most_bytes
        # What others left counts: the first tile that is made gives occasion to look.
        self._written = most_bytes
        self._keys: dict[Path, tuple[tuple[int, int], str]] = {}
        self._levels: OrderedDict[tuple[str, int], Image] = OrderedDict()
        # One picture is decoded at a time, by one thread: several of 50 megapixels would fill the memory, and
        # what a thread gives back is kept for it alone.
        self._decoding = ThreadPoolExecutor(1)

    def tile(self, picture: Path, level: int, column: int, row: int) -> bytes:
        """Give a tile as JPEG.

        level: a power of two of stored pixels; column and row: among its tiles.
        raises InputNotFoundError: when the picture or such a tile does not exist.
        raises InputMalformedError: when the picture cannot be read.
        """
        key = self._key(picture)
        name = f"{level}-{column}-{row}.jpg"
        kept = self._folder / key[:2] / key / name
        try:
            content = kept.read_bytes()
        except OSError:
            made = self._make(picture, key, level, column, row)
            write_file(kept, made)
            self._written += len(made)
            return made
        touch(kept, time.time())
        return content

    def tidy(self) -> None:
        """Remove from the disk what is too much or too old, where enough was written for it to pay."""
        # The disk is looked through again when so much of its share was written.
        sweep_part = 20
        if self._written * sweep_part >= self._most_bytes:
            self._written = 0
            sweep(self._folder, self._most_bytes, UNUSED_S, time.time())

    def _key(self, picture: Path) -> str:
        if not picture.is_file():
            raise InputNotFoundError("does not exist", "was it moved?", where=picture)
        facts = picture.stat()
        state = (facts.st_mtime_ns, facts.st_size)
        known = self._keys.get(picture)
        if known is None or known[0] != state:
            known = (state, digest(picture))
            self._keys[picture] = known
        return known[1]

    def _make(self, picture: Path, key: str, level: int, column: int, row: int) -> bytes:
        # No picture has more levels: a side of 2^24 pixels.
        most_levels = 16
        if not 0 <= level <= most_levels:
            raise InputNotFoundError("has no such tile", "choose another place", where=picture)
        part = self._decoding.submit(self._part, picture, key, level, column, row).result()
        written = BytesIO()
        # Of JPEG: nothing is lost that an eye sees.
        quality = 88
        part.save(written, "JPEG", quality=quality)
        return written.getvalue()

    def _part(self, picture: Path, key: str, level: int, column: int, row: int) -> "Image":
        whole = self._level(picture, key, level)
        left, top = column * TILE_PX, row * TILE_PX
        if column < 0 or row < 0 or left >= whole.width or top >= whole.height:
            raise InputNotFoundError("has no such tile", "choose another place", where=picture)
        return whole.crop((left, top, min(left + TILE_PX, whole.width), min(top + TILE_PX, whole.height)))

    def _level(self, picture: Path, key: str, level: int) -> "Image":
        held = self._levels.get((key, level))
        if held is None:
            finer = [k for name, k in self._levels if name == key and k < level]
            if finer:
                held = self._levels[key, max(finer)].reduce(1 << (level - max(finer)))
            else:
                # Room is made before a picture is decoded, not after.
                self._let_go(self._size(picture, level))
                held = _decoded(picture, level)
            self._levels[key, level] = held
        self._levels.move_to_end((key, level))
        self._let_go(0)
        return held

    def _size(self, picture: Path, level: int) -> int:
        """Pixels of a level of a picture."""
        with opened(picture) as image:
            width, height = image.size
        return (width >> level) * (height >> level)

    def _let_go(self, more_px: int) -> None:
        """Let the levels go that were used longest ago, until so many pixels more have room."""
        kept = int(more_px == 0)
        while len(self._levels) > kept and (
            more_px + sum(image.width * image.height for image in self._levels.values()) > self.held_px
        ):
            self._levels.popitem(last=False)


def _decoded(picture: Path, level: int) -> "Image":
    """Decode a level of a picture: colours where there are 8 bits of them, else grey."""
    from PIL import Image

    with opened(picture) as image:
        if level > coarsest_level(image.size):
            raise InputNotFoundError("has no such tile", "choose another place", where=picture)
        if image.mode not in _MANY_BITS:
            done = _scaled(image, level)
            stored = as_stored(image)
            shown = stored if stored.mode in ("L", "RGB") else stored.convert("RGB")
            return shown.reduce(1 << (level - done)) if level > done else shown
    return Image.fromarray(as_eight_bit(read_grey(picture))).reduce(1 << level)


def _scaled(image: "Image", level: int) -> int:
    """Let a JPEG be decoded at a smaller scale; gives the level that this will be."""
    width, height = image.size
    # JPEG blocks of 8 by 8 pixels can be decoded as 4, 2 or 1 pixel: levels 1 to 3 cost no full decoding.
    coarsest_decoded = 3
    wanted = min(level, coarsest_decoded)
    if image.format != "JPEG" or wanted == 0:
        return 0
    image.draft(image.mode, (max(width >> wanted, 1), max(height >> wanted, 1)))
    return next((k for k in (3, 2, 1) if image.size == (-(-width >> k), -(-height >> k))), 0)
