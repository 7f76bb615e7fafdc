"""`photocal verify`: whether the figures of a certificate follow from its inputs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from acquire.console import answer, progress
from drivers.errors import InputMalformedError, InputNotFoundError

if TYPE_CHECKING:
    from photocal.report.verification import Difference
    from photocal.results.origin import Source


def verify(
    certificate: Annotated[
        Path,
        typer.Argument(
            help="Folder of a certificate, its certificate.json, or a TOML file with a printed calibration."
        ),
    ],
    block: Annotated[
        Path | None,
        typer.Option(
            help="Block folder with the inputs; that carried by the certificate, or near it, if not given."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")] = False,
) -> None:
    """Repeat the computation of a certificate from its inputs and compare every figure.

    A calibration that another program printed (a TOML file) has no inputs: it is checked against itself.

    Example: `photocal verify certificate`
    """
    if certificate.suffix == ".toml":
        _printed(certificate, as_json)
        return
    from photocal.report.record import certified_result, read_record
    from photocal.report.repetition import repeated
    from photocal.report.verification import changed_documents, differences
    from photocal.results.origin import changed_inputs

    certified, folder = read_record(certificate)
    source = _source(certified, folder, block)
    changed = [str(one) for one in changed_inputs(certified_result(certified, folder).inputs, source.folder)]
    documents = changed_documents(certified, folder)
    found: list[Difference] = []
    if not changed:
        with progress("repeating", None) as step:
            found = differences(certified, repeated(certified, folder, source, lambda: step(1)))
    problems = [*changed, *documents, *(f"{d.place} is {d.found}, certified {d.certified}" for d in found)]
    answer(
        as_json,
        lambda: {
            "number": certified["number"],
            "verified": not problems,
            "changed_inputs": changed,
            "changed_documents": documents,
            "differences": [vars(d) for d in found],
        },
        lambda: "\n".join(
            [
                f"certificate {certified['number']}, inputs in {source.folder}",
                *(f"  {line}" for line in problems[:20]),
            ]
            + (
                []
                if problems
                else ["verified: the inputs are the certified ones and give every figure again"]
            )
        ),
    )
    if problems:
        raise InputMalformedError(
            f"not verified: {problems[0]}" + (f" and {len(problems) - 1} more" if len(problems) > 1 else ""),
            where=certificate,
            remedy="ask the issuer for the inputs that belong to the certificate",
        )


def _printed(path: Path, as_json: bool) -> None:
    from photocal.findings.catalogue import catalogue
    from photocal.findings.texts import finding_text
    from photocal.report.acceptance import verdict
    from photocal.report.printed import check_printed

    checked = check_printed(path)
    say = catalogue("en")
    refused = [finding for finding in checked.findings if finding.severity == "refused"]
    judged = verdict(checked.limits)
    answer(
        as_json,
        lambda: {
            "name": checked.name,
            "plausible": not refused,
            "findings": [
                {**vars(f), "figures": dict(f.figures), "text": finding_text(f, say)}
                for f in checked.findings
            ],
            "acceptance": {
                "verdict": judged,
                "limits": [{**vars(limit), "met": limit.met} for limit in checked.limits],
            },
        },
        lambda: "\n".join(
            [
                f"{checked.name}, as printed; limits of the ministry: {say(f'acceptance.{judged}').lower()}",
                *(f"  {say(f'plausibility.{f.severity}')}: {finding_text(f, say)}" for f in checked.findings),
            ]
        ),
    )
    if refused:
        raise InputMalformedError(
            f"cannot be right: {finding_text(refused[0], say)}".removesuffix("."),
            where=path,
            remedy="correct the figures at their source",
        )


def _source(certified: dict[str, Any], folder: Path, block: Path | None) -> Source:
    """What was named, what the certificate carries, or what lies near it with the certified files."""
    from photocal.report.record import certified_result
    from photocal.results.origin import CARRIED, Source, block_of_run

    result = certified_result(certified, folder)
    setup = result.block.setup
    if block is None and (folder / CARRIED).is_dir():
        return Source(folder / CARRIED, setup)
    if block is not None:
        if not block.is_dir():
            raise InputNotFoundError(
                "no such folder", where=block, remedy="name the folder with the inputs by --block"
            )
        return Source(block, setup)
    return block_of_run(folder, result, None, Path.cwd())
