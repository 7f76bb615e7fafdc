"""The one exception tree: each class of failure has its exit code and teaches in one line."""

import errno
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

# What only writing meets: a full disk, a quota, the largest size of a file, a disk that takes nothing.
_NO_ROOM = {errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)}
_WRITING = {*_NO_ROOM, errno.EROFS}


class PhotocalError(Exception):
    """A failure with its place and a remedy.

    what: what happened, in the user's words, without a final full stop.
    remedy: what to do about it.
    where: file, line, image or point that is concerned.
    details: additional figures, a line each.
    """

    exit_code = 1

    def __init__(
        self, what: str, remedy: str = "", *, where: object = None, details: tuple[str, ...] = ()
    ) -> None:
        super().__init__(what)
        self.what = what
        self.details = details
        self.where = "" if where is None else str(where)
        self.remedy = remedy

    @classmethod
    def at(cls, where: object) -> Callable[..., Self]:
        """Make failures of one file or place, so that each check there says what happened and its remedy."""
        return lambda what, remedy="": cls(what, remedy, where=where)

    def __str__(self) -> str:
        # What a hostile file says of itself does not fill the screen.
        longest = 1200
        place = f"{self.where}: " if self.where else ""
        advice = f"; {self.remedy}" if self.remedy else ""
        line = " ".join(f"{place}{self.what}{advice}".split())
        # What a damaged file claims to hold may be longer than anybody reads.
        return line if len(line) <= longest else f"{line[: longest // 2]} ... {line[-longest // 2 :]}"


def reason(failure: Exception) -> str:
    """Say why the system refused, without its number."""
    told = getattr(failure, "strerror", None) or re.sub(r"\[Errno -?\d+\] ", "", str(failure))
    # Python adds the address that a server was to have; the place of the failure names it.
    return (told[:1].lower() + told[1:]).partition(" (while attempting to bind")[0]


class InputNotFoundError(PhotocalError):
    """A file or folder that should be read is missing, empty or of another kind."""

    exit_code = 3


@contextmanager
def reading(path: object, remedy: str = "check name and permissions") -> Iterator[None]:
    """Say in one line why something cannot be read; raises InputNotFoundError."""
    try:
        yield
    except OSError as refusal:
        raise InputNotFoundError(
            f"cannot be read ({reason(refusal)})", where=path, remedy=remedy
        ) from refusal


class InputMalformedError(PhotocalError):
    """A file was read, but its content is not valid."""

    exit_code = 4


class ConfigurationError(PhotocalError):
    """A configuration or set-up file has an unknown key or an impossible value."""

    exit_code = 5


class IllPosedError(PhotocalError):
    """The observations do not determine the unknowns.

    points: names of object points that their own rays leave undetermined, where that is the cause.
    """

    exit_code = 6
    points: tuple[str, ...] = ()

    def of_points(self, names: tuple[str, ...]) -> Self:
        """Name the points that are the cause."""
        self.points = names
        return self


class NotConvergedError(PhotocalError):
    """The iteration ended without reaching the minimum."""

    exit_code = 7


class OutputError(PhotocalError):
    """A result cannot be written where it was asked for."""

    exit_code = 8


class ProgramMissingError(PhotocalError):
    """A program or package of the system that is needed is not installed."""

    exit_code = 9


class DeviceError(PhotocalError):
    """A port, a receiver or an autopilot does not answer as it should."""

    exit_code = 10


class NotSignedError(PhotocalError):
    """A document that is whole in itself, for which nobody answers by a signature."""

    exit_code = 11


class UnknownSignerError(PhotocalError):
    """A document whose signature is right, by a key that is not known here."""

    exit_code = 12


def of_system(refusal: OSError, written: Path | None = None) -> PhotocalError:
    """Say in one line what the system refuses, with the file that it names.

    written: what was being written, for a refusal that names no file.
    """
    number, file, reason = _told(refusal)
    if number in _WRITING or (written is not None and not file):
        remedy = "free disk space and try again" if number in _NO_ROOM else "check path and permissions"
        return OutputError(f"cannot be written ({reason})", remedy, where=file or written)
    if file:
        return InputNotFoundError(f"cannot be opened ({reason})", "check name and permissions", where=file)
    return DeviceError(f"the operating system refuses the access ({reason})", "is a device or a port in use?")


def _told(refusal: OSError) -> tuple[int | None, str, str]:
    """Number, file and reason; of copies of whole folders those of the first file that failed."""
    number, file, reason = refusal.errno, refusal.filename2 or refusal.filename, refusal.strerror
    match refusal.args:
        case ([(_, target, why), *_],):
            found = re.match(r"\[Errno (\d+)\]", str(why))
            number, file, reason = int(found[1]) if found else None, target, str(why)
    if number is not None:
        reason = os.strerror(number)
    name = os.fsdecode(file) if isinstance(file, str | bytes | os.PathLike) else ""
    return number, name, (reason or str(refusal)).lower()


@contextmanager
def system_refusals(written: Path | None = None) -> Iterator[None]:
    """Turn what the system refuses into one line of ours; a reader or peer that went away goes through."""
    try:
        yield
    except ConnectionError:
        raise
    except OSError as refusal:
        raise of_system(refusal, written) from refusal
