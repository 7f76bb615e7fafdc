"""Who answers for a certificate: detached Ed25519 signatures by known keys.

A signature covers the digest of every file of the folder. Ed25519: Bernstein et al. (2012), RFC 8032.
"""

import base64
import datetime as dt
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.base.files import output_file
from photocal.base.operating_system import settings_folder
from photocal.report.journal import note
from photocal.report.keys import (
    Key,
    KnownKey,
    Revocation,
    is_name_of,
    key_name,
    own_key,
    private_key,
    quoted,
    read_object,
    revoked_keys,
    stated_last_day,
)
from photocal.report.timestamp import STAMP

SIGNATURE = "signature.json"
SCHEMA = "photocal.signature/1"
_LINK = "a link"

Trust = Literal["unsigned", "forged", "unknown", "changed", "revoked", "expired", "trusted"]


@dataclass(frozen=True)
class Authenticity:
    """Who has signed, whether that key is known, and what contradicts the signature."""

    trust: Trust
    name: str = ""
    fingerprint: str = ""
    problems: tuple[str, ...] = ()
    noted: Mapping[str, Any] = field(default_factory=dict)
    revoked: Revocation | None = None
    last_day: dt.date | None = None

    def __str__(self) -> str:
        """Say it in a sentence: the key first, and the name between quotes."""
        signed = f"signed with the key {self.fingerprint} by {quoted(self.name)}"
        return {
            "unsigned": "it is not signed",
            "forged": f"{signed}, but {self.problems[0] if self.problems else 'not this'}",
            "unknown": f"{signed}, not known here: compare the key with the issuer, then add --trust",
            "changed": f"{signed}, but this name is known by another key",
            "revoked": f"{signed}, but the key was {self.revoked}",
            "expired": f"{signed}, but the key expired on {self.last_day}, and nothing proves that it signed "
            "before: ask the issuer for a signature with a time stamp, and name its root by --authorities",
            "trusted": f"{signed}, which is known",
        }[self.trust]


@dataclass(frozen=True)
class Signed:
    """By which key something was signed, and what was mended in the journal before."""

    key: Key
    told: str = ""


def sign(folder: Path, number: str, now: dt.datetime, passphrase: str = "") -> Signed:
    """Sign a certificate's folder as it lies there and note it in the journal.

    raises PhotocalError: without a key, with one that others can read, has expired or was revoked, with a
        wrong passphrase, when the folder has links, or when the journal is not whole.
    """
    key, private = own_key(), private_key(passphrase)
    if key is None or private.public_key().public_bytes_raw() != key.public:
        raise ConfigurationError(
            "the two files of the key do not belong together", "restore both", where=settings_folder()
        )
    if revocation := revoked_keys().get(key.fingerprint):
        raise ConfigurationError(
            f"the own key was {revocation}",
            "move its two files away, then make another",
            where=key.fingerprint,
        )
    if key.last_day is not None and key.last_day < now.astimezone(dt.UTC).date():
        raise ConfigurationError(
            f"the own key expired on {key.last_day}",
            "move its two files away, then make another",
            where=key.fingerprint,
        )
    files = manifest(folder)
    if link := next((name for name, digest in files.items() if digest == _LINK), None):
        raise InputMalformedError("is a link", "put the file itself there", where=folder / link)
    entry, told = note(number, files["certificate.json"], now)
    content = {
        "schema": SCHEMA,
        "number": number,
        "name": key.name,
        "public_key": _text(key.public),
        "fingerprint": key.fingerprint,
        **({} if key.last_day is None else {"expires": key.last_day.isoformat()}),
        "signed": now.isoformat(timespec="seconds"),
        "journal": {"entry": entry["entry"], "previous": entry["previous"]},
        "files": files,
    }
    signed = {**content, "signature": _text(private.sign(_canonical(content)))}
    with output_file(folder / SIGNATURE) as aside:
        aside.write_text(json.dumps(signed, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return Signed(key, told)


def manifest(folder: Path) -> dict[str, str]:
    """Give the digests of all files but the signature and its time stamp; of a link only that it is one."""
    files = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            files[name] = _LINK
        elif path.is_file() and name not in (SIGNATURE, STAMP):
            files[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return files


def authenticity(
    folder: Path,
    named: str,
    known: Mapping[str, KnownKey],
    revoked: Mapping[str, Revocation],
    existed: dt.datetime,
) -> Authenticity:
    """Judge the signature of a certificate.

    known: keys that are known, by fingerprint.
    revoked: by fingerprint; it goes before what is known.
    existed: when the signature is proved to have existed, by a verified time stamp; without one, now.
    """
    path = folder / SIGNATURE
    if path.is_symlink() or not path.is_file():
        missing = (f"{SIGNATURE} is missing: the certificate names the key {named}",) if named else ()
        return Authenticity("unsigned", problems=missing)
    content = read_object(path)
    try:
        key, files = _opened(content)
    except (KeyError, TypeError, ValueError) as broken:
        return Authenticity("forged", "?", "?", (f"{SIGNATURE} is no signature ({broken})",))
    journal = content.get("journal")
    noted = journal if isinstance(journal, dict) else {}
    problems = _wrong_in(content, key, named, folder) + _against(files, manifest(folder))
    said = Authenticity("forged", key.name, key.fingerprint, tuple(problems), noted)
    if problems:
        return said
    # What is known here goes before what the signature says of its own key, wherever it ends earlier.
    here = known.get(key.fingerprint)
    last_day = min((day for day in (key.last_day, here and here.last_day) if day), default=None)
    said = replace(said, last_day=last_day)
    if key.fingerprint in revoked:
        return replace(said, trust="revoked", revoked=revoked[key.fingerprint])
    if last_day is not None and last_day < existed.astimezone(dt.UTC).date():
        return replace(said, trust="expired")
    if here is not None:
        return replace(said, trust="trusted", name=here.name or key.name)
    taken = any(is_name_of(key.name, other.name) for other in known.values())
    return replace(said, trust="changed" if taken else "unknown")


def _opened(content: dict[str, Any]) -> tuple[Key, dict[str, Any]]:
    """The key of a signature, and the digests of the files; raises ValueError for what is no signature."""
    if content.get("schema") != SCHEMA:
        raise ValueError(f"schema is {content.get('schema')!r}")
    base64.b64decode(str(content["signature"]), validate=True)
    public = base64.b64decode(str(content["public_key"]), validate=True)
    key = Key(str(content["name"]), public, stated_last_day(content))
    if len(key.public) != 32:
        raise ValueError(f"the key has {len(key.public)} bytes")
    return key, dict(content["files"])


def _wrong_in(content: dict[str, Any], key: Key, named: str, folder: Path) -> list[str]:
    """What is wrong with a signature, the gravest first."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    problems, signed = [], {name: part for name, part in content.items() if name != "signature"}
    try:
        octets = base64.b64decode(content["signature"])
        Ed25519PublicKey.from_public_bytes(key.public).verify(octets, _canonical(signed))
    except (InvalidSignature, TypeError, ValueError):
        problems.append(f"{SIGNATURE} was changed after signing")
    try:
        if key_name(key.name) != key.name:
            problems.append("the name of its key has blanks or letters that look like others")
    except ValueError as wrong:
        problems.append(f"the name of its key {wrong}")
    if content.get("fingerprint") != key.fingerprint:
        problems.append(f"{SIGNATURE} names another fingerprint than that of its key")
    if named and named != key.fingerprint:
        problems.append(f"the certificate names the key {named}")
    if read_object(folder / "certificate.json").get("number") != content.get("number"):
        problems.append(f"{SIGNATURE} was made for the certificate {content.get('number')}")
    return problems


def _against(signed: Mapping[str, Any], there: Mapping[str, str]) -> list[str]:
    return [
        f"{name} was {'added' if name not in signed else 'removed' if name not in there else 'changed'} "
        "after signing"
        for name in sorted(signed.keys() | there.keys())
        if signed.get(name) != there.get(name)
    ]


def _canonical(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()


def _text(octets: bytes) -> str:
    return base64.b64encode(octets).decode()
