"""`photocal verify`: whether the figures of a certificate follow from its inputs."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from acquire.console import answer, progress
from drivers.errors import InputMalformedError, InputNotFoundError

if TYPE_CHECKING:
    from photocal.report.verification import Difference


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
    from photocal.report.record import read_record
    from photocal.report.verification import changed_documents, changed_inputs

    certified, folder = read_record(certificate)
    inputs = _inputs(certified, folder, block)
    changed = changed_inputs(certified, inputs)
    documents = changed_documents(certified, folder)
    found = [] if changed else _differences(certified, inputs)
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
                f"certificate {certified['number']}, inputs in {inputs}",
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
    from photocal.report.acceptance import verdict
    from photocal.report.catalogue import catalogue
    from photocal.report.ministry_sections import finding_text
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


def _inputs(certified: dict[str, Any], folder: Path, block: Path | None) -> Path:
    """The folder that was named, that the certificate carries, or one near it with the certified files."""
    from photocal.commands.run_block import block_of_run
    from photocal.report.carried_inputs import FOLDER

    if block is not None or (folder / FOLDER).is_dir():
        inputs = block if block is not None else folder / FOLDER
        if not inputs.is_dir():
            raise InputNotFoundError(
                "no such folder", where=inputs, remedy="name the block folder by --block"
            )
        return inputs
    return block_of_run(folder, certified["result"], None, Path.cwd())


def _differences(certified: dict[str, Any], inputs: Path) -> list[Difference]:
    """Adjust the certified inputs anew and compare all that the certificate says."""
    from photocal.block.process import adjust_block
    from photocal.report.catalogue import catalogue
    from photocal.report.particulars import given_particulars
    from photocal.report.record import plain_record
    from photocal.report.run import read_run
    from photocal.report.verification import differences

    particulars = given_particulars(certified["particulars"], certified["date"])
    with tempfile.TemporaryDirectory(prefix="photocal-verify-") as name, progress("repeating", 2) as step:
        aside = Path(name)
        # Only what is certified takes part, whatever else lies beside it.
        (aside / "block").mkdir()
        for entry in certified["result"]["inputs"]:
            shutil.copyfile(inputs / entry["path"], aside / "block" / entry["path"])
        adjust_block(aside / "block", aside / "run")
        step(1)
        again = plain_record(read_run(aside / "run"), particulars, catalogue(certified["language"]))
    # A block that does not name itself is called as its folder, which is another one here.
    again["result"]["block"]["name"] = certified["result"]["block"].get("name")
    return differences(certified, again)
