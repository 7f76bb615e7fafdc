"""A block that was measured, and the record of how."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from photocal.base.files import write_json
from photocal.block.model import Block
from photocal.block.writer import write_block

# Of `measurement.json`.
SCHEMA = "photocal.measurement/1"
RECORD = "measurement.json"
PIXEL_ORIGIN = "centre of the upper-left stored pixel is (0, 0); EXIF orientation is not applied"


@dataclass(frozen=True)
class MeasuredBlock:
    """A block that was measured, and how.

    Attributes
    ----------
    block
        Cameras, images, points and observations.
    record
        Content of `measurement.json`: what was measured, left out and found doubtful.
    """

    block: Block
    record: dict[str, Any]

    def write(self, folder: Path) -> None:
        """Write the block folder, and how it was measured beside it."""
        write_block(folder, self.block)
        write_json(folder / RECORD, self.record, 2)
