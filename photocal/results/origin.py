"""The files that a run was made from: found again by their hashes, and carried by a certificate."""

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from photocal.base.errors import InputMalformedError, InputNotFoundError
from photocal.block.model import InputFile, digest
from photocal.results.result import Figures

# Where a certificate carries them.
CARRIED = "inputs"


@dataclass(frozen=True)
class BlockSource:
    """What was adjusted.

    setup: the set-up file of another program within it; empty for a block folder.
    """

    folder: Path
    setup: str = ""

    @property
    def path(self) -> Path:
        """What `photocal adjust` takes: the block folder or the set-up file."""
        return self.folder / self.setup


def changed_inputs(inputs: Sequence[InputFile], folder: Path) -> dict[str, str]:
    """Say of which files, by their paths, that they are missing or not those that were adjusted."""
    changes = {}
    for file in inputs:
        path = folder / file.path
        now = digest(path) if path.is_file() else ""
        if not now:
            changes[file.path] = f"{file.path} is missing"
        elif now != file.sha256:
            hashes = f"SHA-256 {now[:12]}..., certified {file.sha256[:12]}..."
            changes[file.path] = f"{file.path} has changed ({hashes})"
    return changes


def block_of_run(run: Path, result: Figures, given: Path | None, here: Path) -> BlockSource:
    """Find what a run was made from and make sure that it has not changed.

    given: the block folder or set-up file, when the user named it.
    raises InputNotFoundError: when no folder has these files.
    raises InputMalformedError: when a file of the named folder has changed since the run.
    """
    setup = result.block.setup
    if given is not None:
        folder = _root(given, setup) if given.is_file() else given
        changed = changed_inputs(result.inputs, folder)
        if changed:
            raise InputMalformedError(
                "is not the file that the run was made from",
                "adjust the block again, or name the folder of this run",
                where=folder / next(iter(changed)),
            )
        return BlockSource(folder, setup)
    for folder in _candidates(run.resolve(), result, here):
        if not changed_inputs(result.inputs, folder):
            return BlockSource(folder, setup)
    raise InputNotFoundError(
        "no block folder with the files of this run was found beside it or below the current folder",
        "name it with --block, or adjust the block again if it has changed",
        where=run,
    )


def _candidates(run: Path, result: Figures, here: Path) -> Iterator[Path]:
    """Folders that may be it: the one that the run names, then the nearest to the run first."""
    # Folders below the current one that are looked into: `practice/site/work` is three deep.
    deepest = 3
    if result.block.source:
        yield run / result.block.source
    setup = result.block.setup or "block.toml"
    for base, depth in ((run, 0), (run.parent, 1), (here, deepest)):
        for level in range(depth + 1):
            yield from sorted(_root(path, setup) for path in base.glob("*/" * level + setup))


def _root(path: Path, setup: str) -> Path:
    """The folder within which a set-up file has this path."""
    return path.parents[max(len(PurePosixPath(setup).parts), 1) - 1]


def carry(inputs: Sequence[InputFile], source: BlockSource, folder: Path) -> None:
    """Copy the inputs of a run into the folder of a certificate; `folder`: the certificate's."""
    for file in inputs:
        copy = folder / CARRIED / file.path
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source.folder / file.path, copy)
