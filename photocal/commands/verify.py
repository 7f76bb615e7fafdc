"""`photocal keys`, `sign`, `verify`: who signed a certificate, and whether its figures follow."""

import datetime as dt
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from photocal.base.console import Answering, Language, answer, argument, option, printable, spread
from photocal.base.errors import (
    ConfigurationError,
    InputMalformedError,
    InputNotFoundError,
    NotSignedError,
    UnknownSignerError,
)
from photocal.base.progress_bars import progress

if TYPE_CHECKING:
    from photocal.findings.texts import Catalogue
    from photocal.report.signing import Authenticity, Stamped
    from photocal.report.verification import Difference
    from photocal.run.repeated_findings import RepeatedFindings


def keys(
    new: Annotated[str | None, option("Make the key of this person or office.", metavar="NAME")] = None,
    passphrase: Annotated[str, option("Passphrase for the new key.", envvar="PHOTOCAL_PASSPHRASE")] = "",
    expires: Annotated[
        str | None,
        option("Last day on which the new key signs; without, it does not expire.", metavar="YYYY-MM-DD"),
    ] = None,
    journal: Annotated[bool, option("Check and list what was signed.", "--journal")] = False,
    file: Annotated[Path | None, option("Another journal.")] = None,
    language: Language = "",
    as_json: Annotated[bool, option("Print as JSON.", "--json")] = False,
) -> None:
    """Show the known keys by their fingerprints, make one, or list the journal of issued certificates.

    Certificates print the fingerprint of your key; publish it where your clients can find it. The files of
    the key are in your settings folder, readable by you alone: keep a backup elsewhere.

    Example: `photocal keys --new "Laboratory for photogrammetry"`
    """
    from photocal.base.operating_system import settings_folder
    from photocal.findings.texts import catalogue, spoken
    from photocal.report.keys import known_keys, new_key, own_key, quoted, read_journal, revoked_keys

    if journal:
        entries = read_journal(file)
        lines = [printable(f"{e['entry']:>5}  {e['signed']}  {e['number']}  {e['sha256']}") for e in entries]
        answer(as_json, lambda: entries, lambda: "\n".join(lines))
        return
    if new is not None:
        try:
            last_day = None if expires is None else dt.date.fromisoformat(expires)
        except ValueError:
            raise ConfigurationError(
                f"{expires!r} is not a date", "write YYYY-MM-DD", where="--expires"
            ) from None
        new_key(new, passphrase, last_day)
    elif expires is not None:
        raise ConfigurationError(
            "only a new key gets a last day", "name the new key by --new", where="--expires"
        )
    key, known, revoked = own_key(), known_keys(), revoked_keys()
    fingerprint, folder = "" if key is None else key.fingerprint, str(settings_folder())
    say = catalogue(spoken(language))
    known_lines = [
        f"{digits}  {quoted(of.name)}{say('verified.own') * (digits == fingerprint)}"
        + (say("verified.until", day=of.last_day) if of.last_day else "")
        + (f"  {say.stored(str(revoked[digits]))}" if digits in revoked else "")
        for digits, of in known.items()
    ]
    answer(
        as_json,
        lambda: {
            "own": fingerprint or None,
            "known": {digits: of.name for digits, of in known.items()},
            "last_days": {digits: str(of.last_day) for digits, of in known.items() if of.last_day},
            "revoked": {digits: str(entry.day) for digits, entry in revoked.items()},
            "folder": folder,
        },
        lambda: "\n".join(
            [*(known_lines or [say("verified.no_key")]), say("verified.folder", folder=folder)]
        ),
    )


def sign(
    certificate: Annotated[
        Path, argument("Folder of a certificate, or its certificate.json.", metavar="CERTIFICATE")
    ],
    passphrase: Annotated[
        str, option("Passphrase of the signing key, if it has one.", envvar="PHOTOCAL_PASSPHRASE")
    ] = "",
    time_stamp: Annotated[
        str | None,
        option("Time stamping authority (RFC 3161) that gets the digest of the signature.", metavar="URL"),
    ] = None,
    language: Language = "",
    as_json: Annotated[bool, option("Print what was signed as JSON.", "--json")] = False,
) -> None:
    """Sign a certificate with the key of `photocal keys`: every file of its folder.

    The signature, `signature.json` in the same folder, is recorded in a journal whose entries are linked by
    their hashes. With a time stamp (`signature.tsr`) an independent authority confirms when it existed.

    Example: `photocal sign certificate`
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.report.issue import read_record
    from photocal.report.keys import quoted
    from photocal.report.signing import SIGNATURE, STAMP, stamp
    from photocal.report.signing import sign as signed

    certified, folder = read_record(certificate)
    key, told = signed(folder, certified["number"], dt.datetime.now(dt.UTC), passphrase)
    # The stamp of an earlier signature is none of this one; where signing fails, both stay.
    (folder / STAMP).unlink(missing_ok=True)
    file = str(folder / SIGNATURE)
    if told:
        typer.echo(printable(f"warning: {told}"), err=True)
    when = None if time_stamp is None else stamp(folder / SIGNATURE, time_stamp)
    content = {"number": certified["number"], "fingerprint": key.fingerprint, "file": file}
    say = catalogue(spoken(language))
    by = say("verified.signed", fingerprint=key.fingerprint, name=quoted(key.name))
    answer(
        as_json,
        lambda: {**content, "time_stamp": None if when is None else when.time.isoformat()},
        lambda: "\n".join(
            [
                say("verified.signed_now", number=printable(certified["number"]), signed=by, file=file),
                *([] if when is None else [when.text(say)]),
            ]
        ),
    )


@spread
def verify(
    certificate: Annotated[
        Path,
        argument(
            "Folder of a certificate, its certificate.json, or a TOML file with a printed calibration.",
            metavar="CERTIFICATE",
        ),
    ],
    block: Annotated[
        Path | None,
        option("Block folder with the inputs; without: that in the certificate, or near it."),
    ] = None,
    keys: Annotated[
        Path | None, option("List of keys, `FINGERPRINT [LAST DAY] NAME` each: one of them must have signed.")
    ] = None,
    trust: Annotated[
        bool, option("Trust this key from now on, after you have compared its fingerprint.", "--trust")
    ] = False,
    revoked: Annotated[
        Path | None,
        option("List of revoked keys, `FINGERPRINT YYYY-MM-DD REASON` each, in addition to your own."),
    ] = None,
    authorities: Annotated[
        Path | None, option("Root certificates (PEM) of the time stamping authorities that you trust.")
    ] = None,
    issued: Annotated[
        Path | None, option("Journal of the issuer that must have this certificate.", "--journal")
    ] = None,
    *,
    answering: Answering,
) -> None:
    """Repeat a certificate from its inputs, compare every figure and page, and judge its signature.

    Reproducible and authentic are judged separately: anybody can make a certificate that can be repeated;
    only the issuer's key can sign it. The verdict is derived again; statements that cannot be repeated are
    listed as taken from the issuer.

    Exit code 0: reproducible, and signed by a known key. 11: reproducible, not signed. 12: reproducible, and
    signed by a key that is not known here or has expired. 4: not as it was issued, or the key was revoked.

    A calibration that another program printed (a TOML file) has no inputs: it is checked against itself.

    Example: `photocal verify certificate`
    """
    from photocal.findings.texts import catalogue, spoken

    say = catalogue("en" if answering.as_json else spoken(answering.language))
    if certificate.suffix == ".toml":
        _printed(certificate, answering.as_json, say)
        return
    from photocal.base.arrays import as_plain
    from photocal.base.files import digest
    from photocal.findings.verdict import verdict_json
    from photocal.report.issue import NAME, read_record
    from photocal.report.keys import against_journal, known_keys, read_journal, revoked_keys
    from photocal.report.keys import trust as remember
    from photocal.report.signing import SIGNATURE, authenticity
    from photocal.report.verification import changed_files, stated_by_issuer

    certified, folder = read_record(certificate)
    files = changed_files(certified, folder)
    changed: list[str] = []
    differences: list[Difference] = []
    findings: RepeatedFindings | None = None
    if not any(name.endswith(" is a link") for name in files):
        changed, differences, pages, findings = _repeat(certified, folder, block, say)
        files += pages
    responsible = certified["particulars"].get("responsible", {})
    named_key = str(responsible.get("key", "")) if isinstance(responsible, dict) else ""
    when, wrong = _stamped(folder, authorities)
    now = dt.datetime.now(dt.UTC)
    existed = when.time if when is not None and when.verified else now
    signed = authenticity(folder, named_key, known_keys(keys), revoked_keys(revoked), existed)
    problems = [*changed, *files, *(f"{d.place} is {d.found}, certified {d.certified}" for d in differences)]
    problems += findings.false if findings is not None else ()
    reproducible = not problems
    if trust and signed.trust == "unknown" and reproducible:
        remember(signed.name, signed.fingerprint, signed.last_day)
        signed = replace(signed, trust="trusted")
    problems += signed.problems
    if signed.trust in ("changed", "revoked"):
        problems.append(f"{SIGNATURE}: {signed}")
    problems += wrong
    if issued is not None:
        number, noted = certified["number"], signed.noted
        problems += against_journal(read_journal(issued), number, digest(folder / NAME), noted)
    if keys is not None and signed.trust in ("unsigned", "unknown", "expired"):
        problems.append(f"not authentic: {signed}")
    authentic = signed.trust == "trusted"
    judged = None if findings is None else verdict_json(findings.verdict, say)
    if judged is not None and judged["severity"] == "passed":
        # What was never told of the flight's processing cannot be missed: nothing is called clean here.
        clean = say("verified.clean")
        judged |= {"text": clean, "paragraph": clean}
    sentence = "" if judged is None else printable(judged["paragraph"])
    untold = () if findings is None else findings.untold
    taken = [*stated_by_issuer(certified), *(() if findings is None else findings.taken)]
    answer(
        answering.as_json,
        lambda: {
            "number": certified["number"],
            "verified": not problems,
            "reproducible": reproducible,
            "verdict": judged,
            "not_told": list(untold),
            "not_repeated": taken,
            "authentic": authentic,
            "signature": {"trust": signed.trust, "name": signed.name, "fingerprint": signed.fingerprint},
            "time_stamp": None if when is None else {**as_plain(when), "time": when.time.isoformat()},
            "changed_inputs": changed,
            "changed_files": files,
            "differences": as_plain(differences),
            "problems": problems,
        },
        lambda: "\n".join(
            [
                say("verified.certificate", number=printable(certified["number"])),
                *(f"  {printable(say.stored(line))}" for line in problems[:20]),
                say("verified.reproducible" if reproducible else "verified.not_reproducible"),
                *([] if judged is None else [say("verified.judged", text=sentence)]),
                *(f"  {printable(line)}" for line in untold),
                say("verified.taken"),
                *(f"  {printable(say.stored(line))}" for line in taken),
                say(f"verified.{'' if authentic else 'not_'}authentic", text=printable(signed.text(say))),
                *([] if when is None else [when.text(say)]),
            ]
        ),
    )
    if problems:
        raise InputMalformedError(
            f"not verified: {problems[0]}" + (f" and {len(problems) - 1} more" if len(problems) > 1 else ""),
            "ask the issuer for the certificate as it was issued",
            where=certificate,
        )
    _refuse_unknown(signed, certificate)


def _stamped(folder: Path, authorities: Path | None) -> "tuple[Stamped | None, list[str]]":
    """The time stamp of a certificate's signature, and what is wrong with it."""
    from photocal.report.signing import SIGNATURE, STAMP, stamped

    if not (folder / SIGNATURE).is_file():
        return None, [f"{STAMP} has no signature beside it"] if (folder / STAMP).exists() else []
    try:
        return stamped(folder / SIGNATURE, authorities), []
    except InputMalformedError as refusal:
        return None, [f"{STAMP} {refusal.what}"]


def _refuse_unknown(signed: "Authenticity", certificate: Path) -> None:
    """End with an exit code of its own where nothing is wrong but nobody known answers for it."""
    if signed.trust == "unsigned":
        raise NotSignedError(
            "reproducible, but not signed: anybody may have made it",
            "ask the issuer for its signature.json",
            where=certificate,
        )
    if signed.trust == "unknown":
        raise UnknownSignerError(
            f"reproducible, but {signed}", "or name a list of keys by --keys", where=certificate
        )
    if signed.trust == "expired":
        what, _, remedy = str(signed).partition(": ")
        raise UnknownSignerError(f"reproducible, but {what}", remedy, where=certificate)


def _repeat(
    certified: dict[str, Any], folder: Path, block: Path | None, say: "Catalogue"
) -> "tuple[list[str], list[Difference], list[str], RepeatedFindings | None]":
    """Compute, print and judge a certificate anew.

    returns: changed inputs, other figures, pages that say something else, and what was found again.
    """
    from photocal.block.results.folder import CARRIED, BlockSource, changed_inputs
    from photocal.report import verification
    from photocal.report.issue import certified_result
    from photocal.run.repeated_findings import repeated_findings

    if block is None and not (folder / CARRIED).is_dir():
        raise InputNotFoundError(
            "carries no inputs", "name the folder with the inputs by --block", where=folder
        )
    if block is not None and not block.is_dir():
        raise InputNotFoundError("no such folder", "name the folder with the inputs by --block", where=block)
    result = certified_result(certified, folder)
    source = BlockSource(block or folder / CARRIED, result.block.setup)
    changed = list(changed_inputs(result.inputs, source.folder).values())
    if changed:
        return changed, [], [], None
    with progress("repeating", None) as step:
        run = verification.repeated(certified, folder, source, lambda: step(1))
        run = verification.as_certified(run, certified, folder)
        differences = verification.differences(certified, verification.record_of(run, certified))
        if differences:
            return [], differences, [], None
        pages: list[str] = []
        if all((folder / name).is_file() for name in verification.PAGES):
            pages = verification.changed_pages(folder, verification.pages_of(run, certified))
        particulars, _, told = verification.given_by(certified)
        found = repeated_findings(run, source, told, particulars, lambda: step(1), say)
    return [], [], pages, found


def _printed(path: Path, as_json: bool, say: "Catalogue") -> None:
    from photocal.findings.texts import finding_text
    from photocal.report.derived_figures import check_printed, verdict

    name, findings, limits = check_printed(path)
    refused = [finding for finding in findings if finding.severity == "refused"]
    judged = verdict(limits)
    answer(
        as_json,
        lambda: {
            "name": name,
            "plausible": not refused,
            "findings": [
                {**vars(f), "figures": dict(f.figures), "text": finding_text(f, say)} for f in findings
            ],
            "acceptance": {
                "verdict": judged,
                "limits": [{**vars(limit), "met": limit.met} for limit in limits],
            },
        },
        lambda: "\n".join(
            [
                say("verified.printed", name=name, verdict=say(f"acceptance.{judged}").lower()),
                *(f"  {say(f'plausibility.{f.severity}')}: {finding_text(f, say)}" for f in findings),
            ]
        ),
    )
    if refused:
        raise InputMalformedError(
            f"cannot be right: {finding_text(refused[0], say)}".removesuffix("."),
            "correct the figures at their source",
            where=path,
        )
