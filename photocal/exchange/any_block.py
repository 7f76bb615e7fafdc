"""A block, whoever wrote it."""

from __future__ import annotations

from pathlib import Path

from photocal.block.folder import read_block
from photocal.block.model import Block


def read_any_block(source: Path) -> Block:
    """Read a block folder, or the set-up file of another program.

    Raises
    ------
    PhotocalError
        For what cannot be read.
    """
    if not source.is_file():
        return read_block(source)
    # Readers of other programs' formats are many; a block folder needs none of them.
    from photocal.exchange.formats import read_foreign_block

    return read_foreign_block(source)
