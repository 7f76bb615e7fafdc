"""Who answers for a certificate: detached Ed25519 signatures by known keys.

A signature covers the digest of every file of the folder. Ed25519: Bernstein et al. (2012), RFC 8032.

When a certificate was signed: a time stamp of an authority over the signature (RFC 3161), beside it.
"""

import base64
import datetime as dt
import hashlib
import itertools
import json
import os
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import urlsplit

from photocal.base.console import printable
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError, OutputError
from photocal.base.files import refusals, write_file
from photocal.base.operating_system import settings_folder
from photocal.findings.texts import Catalogue, catalogue
from photocal.report.keys import (
    Key,
    KnownKey,
    Revocation,
    is_name_of,
    key_name,
    note,
    own_key,
    private_key,
    quoted,
    read_object,
    revoked_keys,
    stated_last_day,
)

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

STAMP = "signature.tsr"
_LARGEST, _PATIENCE_S = 1 << 16, 20.0


@dataclass(frozen=True)
class Stamped:
    """A time stamp: when the signature existed, the authority, and whether that authority was verified.

    time: UTC.
    authority: subject of the certificate that signed it; empty where it carries none.
    verified: whether the chain ends at an authority that is trusted here.
    """

    time: dt.datetime
    authority: str
    verified: bool

    def text(self, say: Catalogue) -> str:
        """Say it in a line."""
        known = "" if self.verified else say("verified.stamp_unverified")
        by = printable(self.authority) or say("verified.stamp_nobody")
        return say("verified.stamp", time=f"{self.time:%Y-%m-%d %H:%M:%S}", by=by, known=known)


def stamp(signature: Path, authority: str) -> Stamped:
    """Ask a time stamping authority to stamp a signature, and keep its answer beside it.

    Only the digest of the signature leaves this computer.

    raises ConfigurationError: for an address that is not http or https.
    raises InputNotFoundError, InputMalformedError: without a signature, or when the answer is no stamp of it.
    raises OutputError: when the authority cannot be reached, or refuses.
    """
    from rfc3161_client import HashAlgorithm, PKIStatus, TimestampRequestBuilder

    if urlsplit(authority).scheme not in ("http", "https"):
        raise ConfigurationError(
            "is not an http or https address", "name the address of the authority", where=authority
        )
    if not signature.is_file():
        raise InputNotFoundError("there is no signature", "run `photocal sign` first", where=signature)
    content = signature.read_bytes()
    asked = TimestampRequestBuilder().data(content).hash_algorithm(HashAlgorithm.SHA512).build()
    answer = _posted(authority, asked.as_bytes())
    response = _decoded(answer, authority)
    if PKIStatus(response.status) is not PKIStatus.GRANTED:
        said = printable("; ".join(response.status_string)) or PKIStatus(response.status).name
        raise OutputError(f"the authority refuses: {said}", "ask it why, or use another", where=authority)
    if response.tst_info.nonce != asked.nonce or not _is_of(response, content):
        raise InputMalformedError("the time stamp is of other data", "use another authority", where=authority)
    write_file(signature.with_name(STAMP), answer)
    return Stamped(response.tst_info.gen_time, _signer(response), verified=False)


def stamped(signature: Path, authorities: Path | None = None) -> Stamped | None:
    """Read the time stamp beside a signature; None where there is none.

    authorities: PEM file of root certificates that are trusted; without, nothing is verified but what was
        stamped.
    raises InputNotFoundError, InputMalformedError: for another signature's stamp, one that is damaged or not
        by one of these authorities, or a file that holds no certificates.
    """
    path = signature.with_name(STAMP)
    if path.is_symlink() or not path.is_file():
        return None
    if path.stat().st_size > _LARGEST:
        raise InputMalformedError("is not a time stamp: it is too large", "restore it", where=path)
    response, content = _decoded(path.read_bytes(), path), signature.read_bytes()
    if not _is_of(response, content):
        raise InputMalformedError("is the time stamp of another signature", "restore it", where=path)
    if authorities is not None:
        _verify(response, content, _roots(authorities), path)
    return Stamped(response.tst_info.gen_time, _signer(response), authorities is not None)


def _posted(address: str, query: bytes) -> bytes:
    head = {"Content-Type": "application/timestamp-query", "Accept": "application/timestamp-reply"}
    request = urllib.request.Request(address, query, head)  # noqa: S310 - http or https, see `stamp`
    try:
        with urllib.request.urlopen(request, timeout=_PATIENCE_S) as reply:  # noqa: S310 - as above
            answer: bytes = reply.read(_LARGEST + 1)
    except (urllib.error.URLError, OSError, ValueError) as refusal:
        reason = getattr(refusal, "reason", refusal)
        raise OutputError(
            f"the authority does not answer ({reason})", "try again; the signature is kept", where=address
        ) from None
    if len(answer) > _LARGEST:
        raise InputMalformedError("the answer is too large", "use another authority", where=address)
    return answer


def _decoded(octets: bytes, where: object) -> Any:
    from rfc3161_client import PKIStatus, decode_timestamp_response

    try:
        response = decode_timestamp_response(octets)
        # Its parts are parsed when they are asked for; a refusal has none.
        if PKIStatus(response.status) is PKIStatus.GRANTED:
            _ = response.tst_info.gen_time, response.tst_info.message_imprint.message, _signer(response)
    except (ValueError, TypeError) as broken:
        raise InputMalformedError(f"is not a time stamp ({broken})", "restore it", where=where) from None
    return response


def _is_of(response: Any, content: bytes) -> bool:
    """Whether a time stamp is over this content: by the digest that it carries, of 256 bits or more."""
    message = response.tst_info.message_imprint.message
    digests = (hashlib.sha256(content), hashlib.sha384(content), hashlib.sha512(content))
    return any(digest.digest() == message for digest in digests)


def _certificates(response: Any) -> list["Certificate"]:
    from cryptography.x509 import load_der_x509_certificate

    return [load_der_x509_certificate(one) for one in response.signed_data.certificates]


def _signer(response: Any) -> str:
    signers = [(one.issuer, one.serial_number) for one in response.signed_data.signer_infos]
    named = (one for one in _certificates(response) if (one.issuer, one.serial_number) in signers)
    return next((one.subject.rfc4514_string() for one in named), "")


def _roots(path: Path) -> list["Certificate"]:
    from cryptography.x509 import load_pem_x509_certificates

    if not path.is_file():
        raise InputNotFoundError("no such file", "name a PEM file of root certificates", where=path)
    try:
        return load_pem_x509_certificates(path.read_bytes())
    except ValueError as broken:
        raise InputMalformedError(
            f"holds no certificates ({broken})", "name a PEM file of root certificates", where=path
        ) from None


def _verify(response: Any, content: bytes, roots: list["Certificate"], path: Path) -> None:
    from rfc3161_client import VerificationError, VerifierBuilder

    when = response.tst_info.gen_time
    builder = VerifierBuilder()
    for root in roots:
        builder = builder.add_root_certificate(root)
    try:
        builder.build().verify_message(response, content)
    except (VerificationError, ValueError) as refusal:
        raise InputMalformedError(
            f"is not by one of the authorities given ({refusal})", "compare its authority", where=path
        ) from None
    for one in _certificates(response):
        if not one.not_valid_before_utc <= when <= one.not_valid_after_utc:
            raise InputMalformedError(
                "was made when the certificate of its authority was not valid", "ask the issuer", where=path
            )


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
        """Say it in an English sentence."""
        return self.text(catalogue("en"))

    def text(self, say: Catalogue) -> str:
        """Say it in a sentence: the key first, and the name between quotes."""
        signed = say("verified.signed", fingerprint=self.fingerprint, name=quoted(self.name))
        reason = say.stored(self.problems[0]) if self.problems else say("verified.not_this")
        why = {"reason": reason, "day": self.last_day, "revoked": say.stored(str(self.revoked))}
        return say(f"verified.{self.trust}", signed=signed, **why)


def sign(folder: Path, number: str, now: dt.datetime, passphrase: str = "") -> tuple[Key, str]:
    """Sign a certificate's folder as it lies there and note it in the journal.

    returns: the key it was signed with, and what was corrected in the journal before; empty for nothing.
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
            f"your own key was {revocation}",
            "move its two files away, then make another",
            where=key.fingerprint,
        )
    if key.last_day is not None and key.last_day < now.astimezone(dt.UTC).date():
        raise ConfigurationError(
            f"your own key expired on {key.last_day}",
            "move its two files away, then make another",
            where=key.fingerprint,
        )
    files = manifest(folder)
    if link := next((name for name, digest in files.items() if digest == _LINK), None):
        raise InputMalformedError("is a link", "copy the file itself there", where=folder / link)
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
    write_file(folder / SIGNATURE, json.dumps(signed, indent=1, ensure_ascii=False) + "\n")
    return key, told


def keep_signed(folder: Path, certified: bytes) -> str:
    """Move a signed certificate beside its folder, under its number, before another takes its place.

    certified: content of the other `certificate.json`; the same one stays where it is, with its signature.
    returns: the name of the folder where it lies now; empty where nothing was moved.
    """
    record = folder / "certificate.json"
    if not (folder / SIGNATURE).is_file() or (record.is_file() and record.read_bytes() == certified):
        return ""
    signed = str(read_object(folder / SIGNATURE).get("number", ""))
    number = "".join(c if c.isalnum() else "-" for c in signed)[:80]
    names = (f"{folder.name}-{number}{'' if k == 1 else f'-{k}'}" for k in itertools.count(1))
    place = next(free for name in names if not os.path.lexists(free := folder.with_name(name)))
    with refusals(place):
        folder.rename(place)
    return place.name


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
        return Authenticity("forged", "?", "?", (f"{SIGNATURE} is not a signature ({broken})",))
    journal = content.get("journal")
    noted = journal if isinstance(journal, dict) else {}
    problems = [*_wrong_in(content, key, named, folder), *_against(files, manifest(folder))]
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


def _against(signed: Mapping[str, Any], there: Mapping[str, str]) -> Iterator[str]:
    for name in sorted(signed.keys() | there.keys()):
        if name not in signed:
            yield f"{name} was added after signing"
        elif name not in there:
            yield f"{name} was removed after signing"
        elif signed[name] != there[name]:
            yield f"{name} was changed after signing"


def _canonical(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()


def _text(octets: bytes) -> str:
    return base64.b64encode(octets).decode()
