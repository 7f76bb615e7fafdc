"""`photocal sign`: the issuer's signature under a certificate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer


def sign(
    certificate: Annotated[Path, typer.Argument(help="Folder of a certificate, or its certificate.json.")],
    passphrase: Annotated[
        str, typer.Option(envvar="PHOTOCAL_PASSPHRASE", help="Of the key, if it has one.")
    ] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print what was signed as JSON.")] = False,
) -> None:
    """Sign a certificate with the key of `photocal keys`: each file of its folder, as it lies there.

    The signature, `signature.json` beside them, is noted in a journal whose entries depend on each other.

    Example: `photocal sign certificate`
    """
    import datetime as dt

    from photocal.report.record import read_record
    from photocal.report.signing import SIGNATURE
    from photocal.report.signing import sign as signed

    certified, folder = read_record(certificate)
    key = signed(folder, certified["number"], dt.datetime.now(dt.UTC), passphrase)
    file = str(folder / SIGNATURE)
    answer(
        as_json,
        lambda: {"number": certified["number"], "fingerprint": key.fingerprint, "file": file},
        lambda: f"certificate {certified['number']} signed by {key.name}: {file}\n  {key.fingerprint}",
    )
