"""The block of a run, read once and handed to every stage that computes with it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from photocal.block.model import Block

    BlockReader = Callable[[Path], Block]


def block_reader() -> BlockReader:
    """Give a reader for one run, in which the folder of a block is complete before it is read."""

    @functools.cache
    def read(folder: Path) -> Block:
        """Read a folder, or give what was read of it."""
        from photocal.block.folder import read_block

        return read_block(folder)

    return read
