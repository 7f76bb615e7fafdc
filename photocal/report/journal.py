"""The journal of what was signed: each entry has the digest of the one before, a head file that of the last.

What was changed, removed or put in shows by the digests; a cut end by the head, or by a signature that names
a later entry. A journal and its head that are both set back to an earlier copy show by such a signature only.
"""

import datetime as dt
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from photocal.base.checked_json import read_checked_json
from photocal.base.errors import InputMalformedError, InputNotFoundError, OutputError
from photocal.base.files import output_file, refusals
from photocal.base.operating_system import lock, private_folder, settings_folder, sync_folder
from photocal.report.keys import read_object

_JOURNAL = "journal.jsonl"
# Beside a journal: number of its entries and digest of the last, and what a broken write has left.
_HEAD, _TORN = ".head", ".torn"
_NOTHING_BEFORE = "0" * 64
_RESTORE = "compare it with a copy of the journal"


def note(number: str, digest: str, now: dt.datetime) -> tuple[dict[str, Any], str]:
    """Append to the journal of this user, on the disk, too.

    returns: the entry, and what was mended before it; empty where nothing was.
    raises InputMalformedError: when the journal is not whole: it stays as it is.
    """
    path = private_folder(settings_folder()) / _JOURNAL
    with refusals(path), path.open("a+b") as stream:
        if not lock(stream):
            raise OutputError("another program writes into it", "try again", where=path)
        stream.seek(0)
        content = stream.read()
        whole = content[: content.rfind(b"\n") + 1]
        last = content[len(whole) :]
        unended = bool(last) and _follows(content, path)
        whole = content + b"\n" if unended else whole
        _entries(whole, path)
        _not_cut(whole, path)
        told = ""
        if unended:
            stream.write(b"\n")
            told = f"{path}: its last line had no end and got one"
        elif last:
            _set_aside(stream, len(whole), last, path)
            told = f"{path}: a broken last line was moved to {path.with_suffix(_TORN).name}"
        lines = whole.splitlines()
        entry = {
            "entry": len(lines) + 1,
            "number": number,
            "signed": now.isoformat(timespec="seconds"),
            "sha256": digest,
            "previous": hashlib.sha256(lines[-1]).hexdigest() if lines else _NOTHING_BEFORE,
        }
        line = json.dumps(entry, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()
        stream.write(line + b"\n")
        stream.flush()
        os.fsync(stream.fileno())
        sync_folder(path.parent)
        head = {"entries": entry["entry"], "sha256": hashlib.sha256(line).hexdigest()}
        with output_file(path.with_suffix(_HEAD)) as aside:
            aside.write_text(json.dumps(head) + "\n", encoding="utf-8")
    return entry, told


def _follows(content: bytes, path: Path) -> bool:
    """Whether the last line, which has no end, is whole."""
    try:
        _entries(content, path)
    except InputMalformedError:
        return False
    return True


def _set_aside(stream: IO[bytes], length: int, torn: bytes, path: Path) -> None:
    """Move what a broken write has left at the end; nothing was signed by it."""
    with path.with_suffix(_TORN).open("ab") as other:
        other.write(torn + b"\n")
        other.flush()
        os.fsync(other.fileno())
    stream.truncate(length)


def read_journal(path: Path | None = None) -> list[dict[str, Any]]:
    """Read the journal of issued certificates; without a path this user's.

    raises InputMalformedError: for an entry that was changed, removed or put in, and for a cut end.
    """
    source = path or settings_folder() / _JOURNAL
    if not source.is_file():
        raise InputNotFoundError("no such file", "sign a certificate, or name a journal", where=source)
    content = source.read_bytes()
    entries = _entries(content, source)
    _not_cut(content, source)
    return entries


def _entries(content: bytes, source: Path) -> list[dict[str, Any]]:
    entries, before = [], _NOTHING_BEFORE
    lines = content.splitlines(keepends=True)
    for number, line in enumerate(lines, start=1):
        try:
            entry = dict(read_checked_json(line.decode()))
            broken = entry["previous"] != before or entry["entry"] != number
        except (KeyError, TypeError, ValueError, RecursionError):
            broken, entry = True, {}
        if broken:
            torn = number == len(lines) and not line.endswith(b"\n")
            raise InputMalformedError(
                "ends within an entry" if torn else "does not follow from the entry before it",
                f"{'the next `photocal sign` sets it aside; or ' * torn}{_RESTORE}",
                where=f"{source}, line {number}",
            )
        before = hashlib.sha256(line.rstrip(b"\r\n")).hexdigest()
        entries.append(entry)
    return entries


def _not_cut(content: bytes, source: Path) -> None:
    """Compare a journal with its head; one that is longer was noted in just before the computer stopped."""
    path = source.with_suffix(_HEAD)
    if not path.is_file():
        return
    head, lines = read_object(path), content.splitlines()
    count = head.get("entries")
    if not isinstance(count, int) or count < 1:
        raise InputMalformedError("is no head of a journal", _RESTORE, where=path)
    if len(lines) < count:
        what = f"was cut at its end: {len(lines)} entries, {count} were written"
        raise InputMalformedError(what, _RESTORE, where=source)
    if hashlib.sha256(lines[count - 1]).hexdigest() != head.get("sha256"):
        raise InputMalformedError("is not the journal of the head beside it", _RESTORE, where=source)


def against_journal(
    entries: Sequence[Mapping[str, Any]], number: str, digest: str, noted: Mapping[str, Any] | None = None
) -> list[str]:
    """Say what a journal has against a certificate; the last entry of a number counts.

    noted: entry and digest of the one before, as its signature names them.
    """
    known = [entry.get("sha256") for entry in entries if entry.get("number") == number]
    problems = []
    if not known:
        problems.append(f"the journal has no certificate {number}")
    elif known[-1] != digest:
        problems.append(f"certificate.json is not the one that the journal has for {number}")
    place = (noted or {}).get("entry")
    if isinstance(place, int) and place > len(entries):
        problems.append(f"the journal was cut: it has {len(entries)} entries, the signature names {place}")
    elif isinstance(place, int) and noted is not None:
        entry = entries[place - 1] if place > 0 else {}
        if (entry.get("number"), entry.get("previous")) != (number, noted.get("previous")):
            problems.append(f"entry {place} of the journal is not the one that the signature names")
    return problems
