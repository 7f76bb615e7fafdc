"""How kernels are compiled: once, for this machine, kept on disk until their source changes."""

import contextlib
import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar, cast

import numba
from llvmlite import ir
from numba import types
from numba.core.runtime.nrt import rtsys
from numba.extending import intrinsic

from photocal.base.errors import OutputError, ProgramMissingError
from photocal.base.extensions import LENSES, sources
from photocal.base.operating_system import cache_folder, lock, private_folder
from photocal.base.progress import Progress

PACKAGE = Path(__file__).resolve().parents[1]
Function = TypeVar("Function", bound=Callable[..., Any])


# Kernels own no memory: with reference counting left out they run three times as fast. What they fill is
# made by their callers.
_COMMON: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
_LEAN: dict[str, Any] = {**_COMMON, "fastmath": {"contract"}, "_nrt": False}


def fingerprint() -> str:
    """Digest of the source of every kernel.

    The compiler's own cache looks only at the file of the outermost function; a change in a function
    that it calls would go unnoticed.
    """
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for folder in ("geometry", "adjustment", "measurement", "products"):
        for source in sorted((PACKAGE / folder).rglob("*.py")):
            text = source.read_bytes()
            if b"compiled import" in text:
                digest.update(text)
    # Lenses that other packages bring are compiled into ours.
    for name, brought in sources(LENSES).items():
        digest.update(name.encode() + brought)
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    """First folder that can be written: beside the package, the user's cache, a temporary one.

    Compiled code is run as it lies there: outside the package only a folder of this user alone is taken.
    """
    name = f"kernels-{fingerprint()}"
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


FOLDER = _cache_folder()
# Locked by the process that compiles beside a command.
AHEAD = "ahead"
# As many as there are cores, or as the environment says.
THREADS: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]


def compile_all() -> None:
    """Compile all kernels, in several processes side by side, so that nobody waits for them later."""
    parts = (
        "photocal.adjustment.compile as part; part.compile_unusual()",
        "photocal.adjustment.compile as part; part.compile_shaking()",
        "photocal.adjustment.compile as part; part.compile_rolling()",
        "photocal.adjustment.compile as part; part.compile_usual()",
        "photocal.measurement.compile as part; part.compile_kernels()",
        "drivers.scan as part; part.compile_search()",
    )
    if not _side_by_side(parts):
        raise ProgramMissingError("the kernels cannot be compiled", "run: photocal doctor")


def anything_compiled() -> bool:
    """Whether a process has compiled kernels of this source here before."""
    return any(FOLDER.rglob("*.nbi"))


def compile_most_used(progress: Progress) -> None:
    """Compile what nearly every run needs, in processes side by side, and show how far that is."""
    parts = (
        "photocal.adjustment.compile as part; part.compile_usual()",
        "photocal.adjustment.compile as part; part.compile_ahead()",
        "photocal.adjustment.compile as part; part.compile_rolling()",
        "photocal.measurement.compile as part; part.compile_kernels()",
    )
    with progress("compiling, once after installation", None):
        # What fails here is compiled where it is needed, and fails there with its reason.
        _side_by_side(parts, stderr=subprocess.DEVNULL)


def _side_by_side(parts: Sequence[str], stderr: int | None = None) -> bool:
    """Run parts of the compilation, each in a process of its own; whether all went well."""
    commands = ([sys.executable, "-c", f"import {part}"] for part in parts)
    running = [subprocess.Popen(command, stderr=stderr) for command in commands]  # noqa: S603
    try:
        return not sum(abs(part.wait()) for part in running)
    finally:
        for part in running:
            part.kill()


def compile_ahead() -> None:
    """Where nothing was compiled yet, begin beside this process with what an adjustment needs last.

    Of many commands that begin at once, one does; what it began goes on when that command ends.
    """
    if anything_compiled():
        return
    with (FOLDER / AHEAD).open("ab+") as taken:
        if not lock(taken):
            return
    command = [sys.executable, "-c", "import photocal.adjustment.compile as part; part.compile_ahead()"]
    nowhere = subprocess.DEVNULL
    Thread(target=partial(subprocess.run, command, stdout=nowhere, stderr=nowhere), daemon=True).start()


def compiled(function: Function) -> Function:
    """Compile a function of numbers and arrays that makes no arrays."""
    return _compiled(function, **_LEAN)


def _fetch(_: Any, array: Any, place: Any) -> Any:
    """Ask the memory for the line of an element, counted through a contiguous array, that is soon needed."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """Emit the prefetch of an element's address."""
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        ask = builder.module.declare_intrinsic("llvm.prefetch", (byte,), kind)
        element = builder.bitcast(builder.gep(data, [arguments[1]]), byte)
        # To be read, most likely more than once, as data.
        builder.call(ask, [element, number(0), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(array, place), generate


fetch = cast("Callable[[Any, int], None]", intrinsic(_fetch))


def inlined(function: Function) -> Function:
    """Compile a function that makes no arrays so that it melts into its caller."""
    return _compiled(function, **_LEAN, forceinline=True)


def summing(function: Function) -> Function:
    """Compile a function that makes no arrays and whose sums may be added in any order, several at once."""
    return _compiled(function, **{**_LEAN, "fastmath": {"contract", "reassoc"}})


def allocating(function: Function) -> Function:
    """Compile a function that makes arrays."""
    return _compiled(function, **_COMMON)


def _compiled(function: Function, **options: Any) -> Function:
    # The place is asked for here; elsewhere, as for the search of streams, it stays what it is.
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = str(FOLDER)  # type: ignore[attr-defined]
    try:
        made = numba.njit(**options)(function)
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
    made._cache.load_overload = partial(_loaded, made._cache)
    return cast("Function", made)


def _loaded(kept: Any, signature: Any, target: Any) -> Any:
    """A kernel from disk, None where it is not there; what only compilation needs is not loaded.

    That takes longer than the kernels themselves, and the compiler loads it when it is asked to compile.
    """
    rtsys.initialize(target)
    with kept._guard_against_spurious_io_errors():
        return kept._load_overload(signature, target)


def each_piece(count: int, work: Callable[[int], None]) -> None:
    """Do the work of each piece on all threads: kernels run without the interpreter's lock.

    Each thread takes the next piece that nobody has taken. Loops that the compiler itself shares among
    threads would be compiled three times over.
    """
    pieces = iter(range(count))

    def work_on() -> None:
        """Work on the pieces of one thread."""
        for piece in pieces:
            work(piece)

    others = [_threads().submit(work_on) for _ in range(min(count, THREADS) - 1)]
    work_on()
    for other in others:
        other.result()


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(THREADS)


if __name__ == "__main__":
    compile_all()
