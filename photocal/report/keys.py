"""Whose key it is and how long it signs: the own one, those known here, and those that were revoked.

The journal of what was signed: each entry has the digest of the one before, a head file that of the last.

What was changed, removed or put in shows by the digests; a cut end by the head, or by a signature that names
a later entry. A journal and its head that are both set back to an earlier copy show by such a signature only.
"""

import base64
import datetime as dt
import hashlib
import json
import os
import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from photocal.base.checked_toml import read_checked_json
from photocal.base.console import printable
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError, OutputError
from photocal.base.files import compared, plain_name, refusals, write_file
from photocal.base.operating_system import is_private, lock, private_folder, settings_folder, sync_folder

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

_PRIVATE, _OWN, _TRUSTED, _REVOKED = "key.pem", "key.json", "trusted_keys.txt", "revoked_keys.txt"
_LONGEST = 100
_FINGERPRINT = re.compile(r"(?:[0-9A-F]{4} ){9}[0-9A-F]{4}")
_DAY = re.compile(r"\d{4}-\d{2}-\d{2}")
# Alphabets whose letters look like those of another.
_ALIKE = {"LATIN", "CYRILLIC", "GREEK", "ARMENIAN", "CHEROKEE", "COPTIC"}


@dataclass(frozen=True)
class Key:
    """A public key: who uses it, its 32 bytes, the last day of its signatures, and its fingerprint."""

    name: str
    public: bytes
    last_day: dt.date | None = None

    @property
    def fingerprint(self) -> str:
        """First 160 bits of its SHA-256, in groups of four digits."""
        digits = hashlib.sha256(self.public).hexdigest()[:40].upper()
        return " ".join(digits[k : k + 4] for k in range(0, 40, 4))


class KnownKey(NamedTuple):
    """What is known of another's key: its user's name, and the last day of its signatures."""

    name: str
    last_day: dt.date | None = None


@dataclass(frozen=True)
class Revocation:
    """From when on a key is not to be believed, and what was said about it."""

    day: dt.date
    reason: str = ""

    def __str__(self) -> str:
        """Say it, behind "the key"."""
        return f"revoked on {self.day}" + (f" ({printable(self.reason)})" if self.reason else "")


def key_name(name: str) -> str:
    """Return the one form of a key's name.

    raises ValueError: when it cannot be printed on a line as people read it, is longer than 100 characters,
        or has a word in letters of two alphabets.
    """
    plain = plain_name(name)
    if len(plain) > _LONGEST:
        raise ValueError(f"has {len(plain)} characters, {_LONGEST} are allowed")
    if _DAY.match(plain):
        raise ValueError("begins with a day, which lists of keys read as its last one")
    for word in re.split(r"[\W\d_]+", plain):
        alphabets = {unicodedata.name(letter, "").partition(" ")[0] for letter in word} & _ALIKE
        if len(alphabets) > 1:
            raise ValueError(f"has letters of {' and '.join(sorted(alphabets)).title()} in one word")
    return plain


def quoted(name: str) -> str:
    """Return a name between quotes, where it cannot pass for words of ours."""
    return '"' + printable(name[:_LONGEST]).replace('"', "'") + '"'


def new_key(name: str, passphrase: str = "", last_day: dt.date | None = None) -> Key:
    """Make the key of this user; one that exists is never replaced.

    last_day: what it signs later is not believed; None for a key that does not expire.

    raises ConfigurationError: for a name that is none, see `key_name`, or a day that has passed.
    raises OutputError: when there is a key, or it cannot be written.
    """
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    try:
        name = key_name(name)
    except ValueError as wrong:
        raise ConfigurationError(f"the name {wrong}", "choose another name", where="--new") from None
    if last_day is not None and last_day < dt.datetime.now(dt.UTC).date():
        raise ConfigurationError(f"{last_day} has passed", "name a later day", where="--expires")
    path = private_folder(settings_folder()) / _PRIVATE
    if path.exists():
        raise OutputError("there is a key already", "keep it, or move it away yourself", where=path)
    private = Ed25519PrivateKey.generate()
    sealed = (
        serialization.BestAvailableEncryption(passphrase.encode())
        if passphrase
        else serialization.NoEncryption()
    )
    text = private.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, sealed)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(text)
    key = Key(name, private.public_key().public_bytes_raw(), last_day)
    content = {"name": name, "public": base64.b64encode(key.public).decode()}
    expires = {} if last_day is None else {"expires": last_day.isoformat()}
    write_file(path.with_name(_OWN), json.dumps(content | expires))
    return key


def own_key() -> Key | None:
    """Give the public key of this user, if there is one."""
    path = settings_folder() / _OWN
    if not path.is_file():
        return None
    content = read_object(path)
    try:
        public = base64.b64decode(str(content["public"]), validate=True)
        return Key(key_name(str(content["name"])), public, stated_last_day(content))
    except (KeyError, ValueError) as wrong:
        raise InputMalformedError(
            f"is not a key: name, key or day {wrong}", "correct the name, or restore the file", where=path
        ) from None


def stated_last_day(content: Mapping[str, Any]) -> dt.date | None:
    """Read the last day of a key from a file of its own or a signature; raises ValueError for no day."""
    return dt.date.fromisoformat(str(content["expires"])) if "expires" in content else None


def private_key(passphrase: str) -> "Ed25519PrivateKey":
    """Open the private key of this user.

    raises ConfigurationError: with a wrong passphrase, or when others can read it.
    """
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    path = settings_folder() / _PRIVATE
    if not path.is_file():
        raise InputNotFoundError("there is no key", "run: photocal keys --new NAME", where=path)
    wrong = ConfigurationError.at(path)
    if not is_private(path):
        raise wrong(
            "the key is open to others, or another user's",
            f"run: chmod 600 {path}; if anybody may have read it, publish that it is revoked, make another",
        )
    try:
        key = load_pem_private_key(path.read_bytes(), passphrase.encode() or None)
    except (TypeError, ValueError) as refusal:
        raise wrong(f"the key cannot be opened ({refusal})", "give its passphrase") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise wrong("is not an Ed25519 key", "run: photocal keys --new NAME")
    return key


def known_keys(path: Path | None = None) -> dict[str, KnownKey]:
    """Read keys by fingerprint, a line `FINGERPRINT [LAST DAY] NAME` each; without a file this user's."""
    source = path or settings_folder() / _TRUSTED
    own = {key.fingerprint: KnownKey(key.name, key.last_day) for key in (own_key(),) if key and path is None}
    if path is None and not source.is_file():
        return own
    listed: dict[str, KnownKey] = {}
    for where, fingerprint, rest in _lines(source, "write ten groups of four, and the name"):
        malformed = InputMalformedError.at(where)
        if fingerprint in listed:
            raise malformed("has a key that is already listed above", "remove one of the two lines")
        day, _, behind = rest.partition(" ")
        dated = _DAY.fullmatch(day) is not None
        name = behind.strip() if dated else rest
        try:
            last_day = dt.date.fromisoformat(day) if dated else None
        except ValueError:
            raise malformed(
                f"{day!r} is not a date", "write YYYY-MM-DD behind the key, or the name alone"
            ) from None
        try:
            listed[fingerprint] = KnownKey(key_name(name) if name else "", last_day)
        except ValueError as wrong:
            raise malformed(f"the name {wrong}", "ask the issuer, then remove the line") from None
    return own | listed


def revoked_keys(path: Path | None = None) -> dict[str, Revocation]:
    """Read the revoked keys, a line `FINGERPRINT YYYY-MM-DD REASON` each: this user's list, and another."""
    own, revoked = settings_folder() / _REVOKED, dict[str, Revocation]()
    for source in [*([own] if own.is_file() else []), *([path] if path is not None else [])]:
        for where, fingerprint, rest in _lines(source, "write ten groups of four, the day, and the reason"):
            day, _, reason = rest.partition(" ")
            try:
                revoked.setdefault(fingerprint, Revocation(dt.date.fromisoformat(day), reason.strip()))
            except ValueError:
                raise InputMalformedError(
                    f"{day!r} is not a date", "write YYYY-MM-DD behind the key", where=where
                ) from None
    return revoked


def _lines(source: Path, remedy: str) -> Iterator[tuple[str, str, str]]:
    """Lines of a list of keys: where it stands, the fingerprint, and what follows."""
    if not source.is_file():
        raise InputNotFoundError("no such file", "name a list of keys", where=source)
    try:
        text = source.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as broken:
        raise InputMalformedError(
            "is not UTF-8 text", remedy, where=f"{source}, byte {broken.start}"
        ) from None
    # Only a line feed ends a line: what else Python takes for an end may hide a second entry in a name.
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip() and not line.startswith("#"):
            words = line.split()
            fingerprint = " ".join(words[:10]).upper()
            if len(words) < 11 or not _FINGERPRINT.fullmatch(fingerprint):
                raise InputMalformedError("is not a key", remedy, where=f"{source}, line {number}")
            rest = line.strip(" \t\r").split(maxsplit=10)[10]
            yield f"{source}, line {number}", fingerprint, rest


def trust(name: str, fingerprint: str, last_day: dt.date | None = None) -> None:
    """Remember a key, by one line more; a name that is known by another one is refused."""
    known, path = known_keys(), settings_folder() / _TRUSTED
    if any(is_name_of(name, other.name) for key, other in known.items() if key != fingerprint):
        raise ConfigurationError(
            f"{quoted(name)} is known by another key",
            "ask the issuer, then remove the old line yourself",
            where=path,
        )
    if fingerprint in known:
        return
    private_folder(settings_folder())
    before = path.read_text(encoding="utf-8").rstrip("\n") if path.is_file() else ""
    until = "" if last_day is None else f"{last_day} "
    lines = [*([before] if before else []), f"{fingerprint} {until}{key_name(name)}"]
    write_file(path, "\n".join(lines) + "\n")


def is_name_of(name: str, other: str) -> bool:
    """Whether people would take two names for the same."""
    return compared(name) == compared(other)


def read_object(path: Path) -> dict[str, Any]:
    """Read a file of one JSON object; raises InputMalformedError for anything else."""
    try:
        content = read_checked_json(path.read_bytes().decode())
    except (OSError, ValueError, RecursionError) as broken:
        raise InputMalformedError(f"cannot be read ({broken})", "restore it", where=path) from None
    if not isinstance(content, dict):
        raise InputMalformedError("is not a JSON object", "restore it", where=path)
    return content


_JOURNAL = "journal.jsonl"
# Beside a journal: number of its entries and digest of the last, and what a broken write has left.
_HEAD, _TORN = ".head", ".torn"
_NOTHING_BEFORE = "0" * 64
_RESTORE = "compare it with a copy of the journal"


def note(number: str, digest: str, now: dt.datetime) -> tuple[dict[str, Any], str]:
    """Append to the journal of this user, on the disk, too.

    returns: the entry, and what was corrected before it; empty where nothing was.
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
        write_file(path.with_suffix(_HEAD), json.dumps(head) + "\n")
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
        raise InputMalformedError("is not the head of a journal", _RESTORE, where=path)
    if len(lines) < count:
        what = f"was truncated at its end: {len(lines)} entries, {count} were written"
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
        problems.append(f"the journal was truncated: {len(entries)} entries, the signature names {place}")
    elif isinstance(place, int) and noted is not None:
        entry = entries[place - 1] if place > 0 else {}
        if (entry.get("number"), entry.get("previous")) != (number, noted.get("previous")):
            problems.append(f"entry {place} of the journal is not the one that the signature names")
    return problems
