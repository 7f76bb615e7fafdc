"""How kernels are compiled: once, for this machine, kept on disk until their source changes."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from acquire.operating_system import cache_folder, private_folder
from drivers.errors import OutputError, ProgramMissingError

PACKAGE = Path(__file__).resolve().parent


def _fingerprint() -> str:
    """Digest of the source of every kernel.

    The compiler's own cache looks only at the file of the outermost function; a change in a function
    that it calls would go unnoticed.
    """
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for folder in ("geometry", "adjustment"):
        for source in sorted((PACKAGE / folder).rglob("*.py")):
            text = source.read_bytes()
            if b"compiled import" in text:
                digest.update(text)
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    """First folder that can be written: beside the package, the user's cache, a temporary one.

    Compiled code is run as it lies there: outside the package only a folder of this user alone is taken.
    """
    name = f"kernels-{_fingerprint()}"
    beside = PACKAGE / "__pycache__" / name
    with contextlib.suppress(OSError):
        beside.mkdir(parents=True, exist_ok=True)
        if os.access(beside, os.W_OK):
            return beside
    temporary = Path(tempfile.gettempdir()) / f"photocal-{getattr(os, 'getuid', int)()}"
    for folder in (cache_folder() / name, temporary):
        with contextlib.suppress(OutputError):
            return private_folder(private_folder(folder) / name)
    return Path(tempfile.mkdtemp(prefix="photocal-"))


numba.config.CACHE_DIR = str(_cache_folder())  # type: ignore[attr-defined]


def compile_all() -> None:
    """Compile the kernels of adjustment and matching side by side, so that nobody waits for them later."""
    parts = ("photocal.adjustment.compile", "photocal.measurement.compile")
    running = [subprocess.Popen([sys.executable, "-m", part]) for part in parts]  # noqa: S603 - our own
    if sum(abs(part.wait()) for part in running):
        raise ProgramMissingError("the kernels cannot be compiled", remedy="run: photocal doctor")


Function = TypeVar("Function", bound=Callable[..., Any])


# Kernels own no memory: with reference counting left out they run three times as fast. What they fill is
# made by their callers.
_COMMON: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
_LEAN: dict[str, Any] = {**_COMMON, "fastmath": {"contract"}, "_nrt": False}


def compiled(function: Function) -> Function:
    """Compile a function of numbers and arrays that makes no arrays."""
    return cast("Function", numba.njit(**_LEAN)(function))


def inlined(function: Function) -> Function:
    """Compile a function that makes no arrays so that it melts into its caller."""
    return cast("Function", numba.njit(**_LEAN, forceinline=True)(function))


def allocating(function: Function) -> Function:
    """Compile a function that makes arrays."""
    return cast("Function", numba.njit(**_COMMON)(function))


def compiled_parallel(function: Function) -> Function:
    """Compile a function that may make arrays and whose `numba.prange` loops share a design's pieces.

    Its first argument is the design. Threads without a piece are not woken: that costs more than a small
    block's work, and ten times as much where other programs use the machine's cores.
    """
    kernel = numba.njit(**_COMMON, parallel=True)(function)

    @functools.wraps(function)
    def divided(design: Any, *others: Any) -> Any:
        allowed = numba.get_num_threads()
        numba.set_num_threads(min(allowed, len(design.pieces) - 1))
        try:
            return kernel(design, *others)
        finally:
            numba.set_num_threads(allowed)

    return cast("Function", divided)


if __name__ == "__main__":
    compile_all()
