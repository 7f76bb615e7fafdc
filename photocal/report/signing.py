"""Who answers for a certificate: detached Ed25519 signatures, known keys, a journal of what was signed.

A signature covers the digest of every file of the folder. Ed25519: Bernstein et al. (2012), RFC 8032.
"""

import base64
import datetime as dt
import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError, OutputError
from photocal.base.files import output_file
from photocal.base.operating_system import lock, private_folder, settings_folder

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

SIGNATURE = "signature.json"
SCHEMA = "photocal.signature/1"
_PRIVATE, _OWN, _TRUSTED, _JOURNAL = "key.pem", "key.json", "trusted_keys.txt", "journal.jsonl"
_NOTHING_BEFORE = "0" * 64
_LINK = "a link"

Trust = Literal["unsigned", "forged", "unknown", "changed", "trusted"]


@dataclass(frozen=True)
class Key:
    """A public key: who uses it, its 32 bytes, and by what people compare it."""

    name: str
    public: bytes

    @property
    def fingerprint(self) -> str:
        """First 160 bits of its SHA-256, in groups of four digits."""
        digits = hashlib.sha256(self.public).hexdigest()[:40].upper()
        return " ".join(digits[k : k + 4] for k in range(0, 40, 4))


@dataclass(frozen=True)
class Authenticity:
    """Who has signed, whether that key is known, and what contradicts the signature."""

    trust: Trust
    name: str = ""
    fingerprint: str = ""
    problems: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Say it in a sentence."""
        signed = f"signed by {self.name} with the key {self.fingerprint}"
        return {
            "unsigned": "it is not signed",
            "forged": f"{signed}, but {self.problems[0] if self.problems else 'not this'}",
            "unknown": f"{signed}, not known here: compare it with the issuer, then add --trust",
            "changed": f"{signed}, but {self.name} is known by another key",
            "trusted": f"{signed}, which is known",
        }[self.trust]


def new_key(name: str, passphrase: str = "") -> Key:
    """Make the key of this user; one that exists is never replaced."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

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
    key = Key(name, private.public_key().public_bytes_raw())
    with output_file(path.with_name(_OWN)) as aside:
        aside.write_text(json.dumps({"name": name, "public": _text(key.public)}), encoding="utf-8")
    return key


def own_key() -> Key | None:
    """Give the public key of this user, if there is one."""
    path = settings_folder() / _OWN
    if not path.is_file():
        return None
    content = _json(path)
    return Key(str(content["name"]), base64.b64decode(str(content["public"])))


def sign(folder: Path, number: str, now: dt.datetime, passphrase: str = "") -> Key:
    """Sign a certificate's folder as it lies there and note it in the journal.

    raises PhotocalError: without a key, with a wrong passphrase, or when the folder has links.
    """
    key, private = own_key(), _private(passphrase)
    if key is None or private.public_key().public_bytes_raw() != key.public:
        raise ConfigurationError(
            "the two files of the key do not belong together", "restore both", where=settings_folder()
        )
    files = manifest(folder)
    if link := next((name for name, digest in files.items() if digest == _LINK), None):
        raise InputMalformedError("is a link", "put the file itself there", where=folder / link)
    entry = _note(number, files["certificate.json"], now)
    content = {
        "schema": SCHEMA,
        "number": number,
        "name": key.name,
        "public_key": _text(key.public),
        "fingerprint": key.fingerprint,
        "signed": now.isoformat(timespec="seconds"),
        "journal": {"entry": entry["entry"], "previous": entry["previous"]},
        "files": files,
    }
    signed = {**content, "signature": _text(private.sign(_canonical(content)))}
    with output_file(folder / SIGNATURE) as aside:
        aside.write_text(json.dumps(signed, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return key


def manifest(folder: Path) -> dict[str, str]:
    """Give the digests of all files of a folder but its signature; of a link only that it is one."""
    files = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            files[name] = _LINK
        elif path.is_file() and name != SIGNATURE:
            files[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return files


def authenticity(folder: Path, named: str, known: Mapping[str, str]) -> Authenticity:
    """Judge the signature of a certificate; `known`: names by the fingerprints of known keys."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    path = folder / SIGNATURE
    if path.is_symlink() or not path.is_file():
        missing = (f"{SIGNATURE} is missing: the certificate names the key {named}",) if named else ()
        return Authenticity("unsigned", problems=missing)
    content = _json(path)
    try:
        signature = base64.b64decode(str(content.pop("signature")), validate=True)
        key = Key(str(content["name"]), base64.b64decode(str(content["public_key"]), validate=True))
        files, number = dict(content["files"]), str(content["number"])
        Ed25519PublicKey.from_public_bytes(key.public).verify(signature, _canonical(content))
    except InvalidSignature:
        return Authenticity("forged", key.name, key.fingerprint, (f"{SIGNATURE} was changed after signing",))
    except (KeyError, TypeError, ValueError) as broken:
        return Authenticity("forged", "?", "?", (f"{SIGNATURE} is no signature ({broken})",))
    problems = _against(files, manifest(folder))
    if content.get("fingerprint") != key.fingerprint:
        problems.append(f"{SIGNATURE} names another fingerprint than that of its key")
    if named and named != key.fingerprint:
        problems.append(f"the certificate names the key {named}")
    if _json(folder / "certificate.json").get("number") != number:
        problems.append(f"{SIGNATURE} was made for the certificate {number}")
    if problems:
        return Authenticity("forged", key.name, key.fingerprint, tuple(problems))
    if key.fingerprint in known:
        return Authenticity("trusted", known[key.fingerprint] or key.name, key.fingerprint)
    trust: Trust = "changed" if key.name in known.values() else "unknown"
    return Authenticity(trust, key.name, key.fingerprint)


def _against(signed: Mapping[str, Any], there: Mapping[str, str]) -> list[str]:
    return [
        f"{name} was {'added' if name not in signed else 'removed' if name not in there else 'changed'} "
        "after signing"
        for name in sorted(signed.keys() | there.keys())
        if signed.get(name) != there.get(name)
    ]


def known_keys(path: Path | None = None) -> dict[str, str]:
    """Read names by fingerprint, a line `FINGERPRINT NAME` each; without a file this user's."""
    source = path or settings_folder() / _TRUSTED
    if not source.is_file():
        if path is not None:
            raise InputNotFoundError("no such file", "name a list of keys", where=path)
        key = own_key()
        return {key.fingerprint: key.name} if key else {}
    known = {} if path is not None else {key.fingerprint: key.name for key in (own_key(),) if key}
    for number, line in enumerate(source.read_text(encoding="utf-8").splitlines(), start=1):
        if line.strip() and not line.startswith("#"):
            words = line.split()
            if len(words) < 11 or any(len(word) != 4 for word in words[:10]):
                raise InputMalformedError(
                    "is no key", "write ten groups of four, and the name", where=f"{source}, line {number}"
                )
            known[" ".join(words[:10]).upper()] = " ".join(words[10:])
    return known


def trust(name: str, fingerprint: str) -> None:
    """Remember a key; a name that is known by another one is refused."""
    known = known_keys()
    if name in known.values() and known.get(fingerprint) != name:
        raise ConfigurationError(
            f"{name} is known by another key",
            "ask the issuer, then remove the old line yourself",
            where=settings_folder() / _TRUSTED,
        )
    lines = [f"{digits} {owner}" for digits, owner in {**known, fingerprint: name}.items()]
    private_folder(settings_folder())
    with output_file(settings_folder() / _TRUSTED) as aside:
        aside.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _note(number: str, digest: str, now: dt.datetime) -> dict[str, Any]:
    """Append to the journal of this user: each line carries the digest of the one before."""
    path = private_folder(settings_folder()) / _JOURNAL
    with path.open("a+b") as stream:
        if not lock(stream):
            raise OutputError("another program writes into it", "try again", where=path)
        stream.seek(0)
        lines = stream.read().splitlines()
        entry = {
            "entry": len(lines) + 1,
            "number": number,
            "signed": now.isoformat(timespec="seconds"),
            "sha256": digest,
            "previous": hashlib.sha256(lines[-1]).hexdigest() if lines else _NOTHING_BEFORE,
        }
        stream.write(_canonical(entry) + b"\n")
    return entry


def journal(path: Path | None = None) -> list[dict[str, Any]]:
    """Read the journal of issued certificates; an entry that was changed, removed or put in is refused."""
    source = path or settings_folder() / _JOURNAL
    if not source.is_file():
        raise InputNotFoundError("no such file", "sign a certificate, or name a journal", where=source)
    entries, before = [], _NOTHING_BEFORE
    for number, line in enumerate(source.read_bytes().splitlines(), start=1):
        try:
            entry = dict(json.loads(line))
            broken = entry["previous"] != before or entry["entry"] != number
        except (KeyError, TypeError, ValueError, RecursionError):
            broken, entry = True, {}
        if broken:
            raise InputMalformedError(
                "does not follow from the entry before it",
                "compare it with a copy of the journal",
                where=f"{source}, line {number}",
            )
        before = hashlib.sha256(line).hexdigest()
        entries.append(entry)
    return entries


def against_journal(entries: Iterable[Mapping[str, Any]], number: str, digest: str) -> list[str]:
    """Say what a journal has against a certificate; the last entry of a number counts."""
    noted = [entry.get("sha256") for entry in entries if entry.get("number") == number]
    if not noted:
        return [f"the journal has no certificate {number}"]
    other = f"certificate.json is not the one that the journal has for {number}"
    return [] if noted[-1] == digest else [other]


def _private(passphrase: str) -> "Ed25519PrivateKey":
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    path = settings_folder() / _PRIVATE
    if not path.is_file():
        raise InputNotFoundError("there is no key", "run: photocal keys --new NAME", where=path)
    wrong = ConfigurationError.at(path)
    try:
        key = load_pem_private_key(path.read_bytes(), passphrase.encode() or None)
    except (TypeError, ValueError) as refusal:
        raise wrong(f"the key cannot be opened ({refusal})", "give its passphrase") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise wrong("is no Ed25519 key", "run: photocal keys --new NAME")
    return key


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as broken:
        raise InputMalformedError(f"cannot be read ({broken})", "restore it", where=path) from None
    if not isinstance(content, dict):
        raise InputMalformedError("is no JSON object", "restore it", where=path)
    return content


def _canonical(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()


def _text(octets: bytes) -> str:
    return base64.b64encode(octets).decode()
