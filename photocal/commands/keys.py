"""`photocal keys`: the key that signs certificates, those of others, and the journal."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer


def keys(
    new: Annotated[
        str | None, typer.Option(metavar="NAME", help="Make the key of this person or office.")
    ] = None,
    passphrase: Annotated[
        str, typer.Option(envvar="PHOTOCAL_PASSPHRASE", help="That the new key asks for.")
    ] = "",
    journal: Annotated[bool, typer.Option("--journal", help="Check and list what was signed.")] = False,
    file: Annotated[Path | None, typer.Option(help="Another journal.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Show the known keys by their fingerprints, make one, or list the journal of issued certificates.

    With a key, certificates print its fingerprint; publish it where your clients look. Its files lie in your
    folder of settings, closed to others: keep a copy of them apart.

    Example: `photocal keys --new "Laboratory for photogrammetry"`
    """
    from acquire.operating_system import settings_folder
    from photocal.report import signing

    if journal:
        entries = signing.journal(file)
        lines = [f"{e['entry']:>5}  {e['signed']}  {e['number']}  {e['sha256']}" for e in entries]
        answer(as_json, lambda: entries, lambda: "\n".join(lines))
        return
    if new is not None:
        signing.new_key(new, passphrase)
    own, known = signing.own_key(), signing.known_keys()
    mine, folder = "" if own is None else own.fingerprint, str(settings_folder())
    known_lines = [f"{digits}  {name}{'  (own)' * (digits == mine)}" for digits, name in known.items()]
    answer(
        as_json,
        lambda: {"own": mine or None, "known": known, "folder": folder},
        lambda: "\n".join([*(known_lines or ["no key is known"]), f"in {folder}"]),
    )
