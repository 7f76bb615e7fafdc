"""`acquire recover`: repair of a flight log that ends early."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquire.console import answer
from drivers.errors import ConfigurationError

if TYPE_CHECKING:
    from acquire.log.recovery import Recovered


def recover(
    log: Annotated[Path, typer.Argument(help="Flight log (.mcap); it is not changed.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Repaired log (default: NAME.recovered.mcap).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Save every whole chunk of a flight log that was cut or damaged.

    Example: `acquire recover flight.mcap -o repaired.mcap`
    """
    from acquire.log.recovery import recover as repair

    target = output or log.with_suffix(".recovered.mcap")
    if target.resolve() == log.resolve():
        raise ConfigurationError(
            "the repaired log would take the place of the damaged one", where=target, remedy="name another"
        )
    result = repair(log, target)
    answer(
        as_json,
        lambda: {
            "schema": "acquire.recover/1",
            "file": str(log),
            "output": str(target),
            "messages": result.messages,
            "chunks": result.chunks,
            "had_its_end": result.complete,
            "damaged": list(result.damaged),
        },
        lambda: _text(result, log, target),
    )


def _text(result: Recovered, log: Path, target: Path) -> str:
    if result.intact:
        return f"{log} was whole, {target} is a copy: {result.messages} messages"
    lines = [f"saved {result.messages} messages in {result.chunks} chunks to {target}"]
    if not result.complete:
        lines.append("the log had no end: what was written after its last whole chunk is lost")
    lines += [f"passed over: {text}" for text in result.damaged]
    return "\n".join(lines)
