"""When a certificate was signed: a time stamp of an authority over the signature (RFC 3161), beside it."""

import datetime as dt
import hashlib
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from photocal.base.console import printable
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError, OutputError
from photocal.base.files import output_file

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

STAMP = "signature.tsr"
_LARGEST, _PATIENCE_S = 1 << 16, 20.0


@dataclass(frozen=True)
class Stamped:
    """A time stamp: when the signature existed, by whom, and whether that authority was verified.

    time: UTC.
    authority: subject of the certificate that signed it; empty where it carries none.
    verified: whether the chain ends at an authority that is trusted here.
    """

    time: dt.datetime
    authority: str
    verified: bool

    def __str__(self) -> str:
        """Say it in a line."""
        known = (
            "" if self.verified else ", an authority that was not verified: name its root by --authorities"
        )
        by = printable(self.authority) or "an authority without a certificate"
        return f"time stamp of {self.time:%Y-%m-%d %H:%M:%S} UTC by {by}{known}"


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
            "is no http or https address", "name the address of the authority", where=authority
        )
    if not signature.is_file():
        raise InputNotFoundError("there is no signature", "run `photocal sign` first", where=signature)
    content = signature.read_bytes()
    asked = TimestampRequestBuilder().data(content).hash_algorithm(HashAlgorithm.SHA512).build()
    answer = _posted(authority, asked.as_bytes())
    response = _decoded(answer, authority)
    if PKIStatus(response.status) is not PKIStatus.GRANTED:
        said = printable("; ".join(response.status_string)) or PKIStatus(response.status).name
        raise OutputError(f"the authority refuses: {said}", "ask it why, or take another", where=authority)
    if response.tst_info.nonce != asked.nonce or not _is_of(response, content):
        raise InputMalformedError(
            "the answer stamps something else", "take another authority", where=authority
        )
    with output_file(signature.with_name(STAMP)) as aside:
        aside.write_bytes(answer)
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
        raise InputMalformedError("is no time stamp: it is too large", "restore it", where=path)
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
            f"the authority does not answer ({reason})", "try again; the signature stands", where=address
        ) from None
    if len(answer) > _LARGEST:
        raise InputMalformedError("the answer is too large", "take another authority", where=address)
    return answer


def _decoded(octets: bytes, where: object) -> Any:
    from rfc3161_client import PKIStatus, decode_timestamp_response

    try:
        response = decode_timestamp_response(octets)
        # Its parts are parsed when they are asked for; a refusal has none.
        if PKIStatus(response.status) is PKIStatus.GRANTED:
            _ = response.tst_info.gen_time, response.tst_info.message_imprint.message, _signer(response)
    except (ValueError, TypeError) as broken:
        raise InputMalformedError(f"is no time stamp ({broken})", "restore it", where=where) from None
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
