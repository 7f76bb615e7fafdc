"""A new format is a module and one entry: it is exported, found again and read by that alone."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from photocal.exchange import formats
from photocal.exchange.formats import read_any_block
from photocal.exchange.reconstruction import Choices, Reconstruction

TOY = formats.Format(
    "toy", "Toy", formats.WHOLE, "own", formats.CENTRE, formats.PHOTO, "none", "px, m",
    "tests.photocal.exchange.toy_format:export", "", "tests.photocal.exchange.toy_format:block", ("*.toy",),
)  # fmt: skip


def test_one_entry_is_enough(vision: Reconstruction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(formats, "FORMATS", (*formats.FORMATS, TOY))
    assert "toy" in formats.exported()
    assert "| `toy` | Toy |" in formats.page()
    formats.export(formats.named("toy"), tmp_path, vision, Choices())
    block = read_any_block(tmp_path / "block.toy")
    assert block.images.names == vision.image_names
    np.testing.assert_array_equal(block.observations.values, vision.pixels)


def test_the_table_loads_no_format() -> None:
    import subprocess
    import sys

    code = (
        "import sys, photocal.exchange.formats; "
        "print([m for m in sys.modules if m.startswith('photocal.exchange.') or m == 'numpy'])"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert told.strip() == "['photocal.exchange.formats']"


def test_every_function_of_the_table_exists() -> None:
    for form in formats.FORMATS:
        for name in (form.writes, form.reads, form.blocks, form.recognises):
            module, function = (*name.split(":"), "")[:2]
            assert not name or hasattr(import_module(f"photocal.exchange.{module}"), function), name
