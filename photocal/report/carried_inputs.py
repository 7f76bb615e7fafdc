"""The inputs that a certificate carries, so that whoever has it can repeat the computation."""

from __future__ import annotations

import shutil
from pathlib import Path

from photocal.report.run import Run

FOLDER = "inputs"


def carry(run: Run, block: Path, folder: Path) -> None:
    """Copy the inputs of a run into the folder of a certificate.

    Parameters
    ----------
    run : Run
        The run.
    block : Path
        Block folder with the very files that the run names.
    folder : Path
        The certificate's.
    """
    (folder / FOLDER).mkdir()
    for file in run.result.inputs:
        shutil.copyfile(block / file.path, folder / FOLDER / file.path)
