"""The inputs that a certificate carries, so that whoever has it can repeat the computation."""

from __future__ import annotations

import shutil
from pathlib import Path

from drivers.errors import InputMalformedError, InputNotFoundError
from photocal.report.run import InputFile, Run
from photocal.report.verification import digest

FOLDER = "inputs"


def find_inputs(run: Run, run_folder: Path, block: Path | None) -> Path | None:
    """Find the block folder that a run was made from.

    Parameters
    ----------
    run : Run
        The run.
    run_folder : Path
        Where it lies.
    block : Path or None
        The block folder if a person named it.

    Returns
    -------
    Path or None
        A folder whose files are those that the run names; None when it is not known or no longer so.

    Raises
    ------
    InputNotFoundError
        When the folder that was named lacks a file.
    InputMalformedError
        When a file of it is not the one that was adjusted.
    """
    if block is not None:
        for file in run.result.inputs:
            _require(block, file)
        return block
    known = run.result.block.folder
    folder = run_folder / known
    return folder if known and all(_is_there(folder, file) for file in run.result.inputs) else None


def carry(run: Run, block: Path, folder: Path) -> None:
    """Copy the inputs of a run into the folder of a certificate.

    Parameters
    ----------
    run : Run
        The run.
    block : Path
        From `find_inputs`.
    folder : Path
        The certificate's.
    """
    (folder / FOLDER).mkdir()
    for file in run.result.inputs:
        shutil.copyfile(block / file.path, folder / FOLDER / file.path)


def _is_there(folder: Path, file: InputFile) -> bool:
    path = folder / file.path
    return path.is_file() and path.stat().st_size == file.bytes and digest(path) == file.sha256


def _require(folder: Path, file: InputFile) -> None:
    path = folder / file.path
    if not path.is_file():
        raise InputNotFoundError(
            "the run was made from this file", where=path, remedy="name its block folder"
        )
    if not _is_there(folder, file):
        raise InputMalformedError(
            "is not the file that was adjusted (its SHA-256 differs)",
            where=path,
            remedy="adjust the block again",
        )
