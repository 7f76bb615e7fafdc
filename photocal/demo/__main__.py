"""`python -m photocal.demo`: what `make demo` runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import application, run

app = application("Demonstrations: a simulated flight with known truth, a camera of a published study.")


@app.callback(invoke_without_command=True, no_args_is_help=False)
def flight(
    context: typer.Context,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "demo-output"
    ),
    plan: Annotated[Path, typer.Option(help="Flight to simulate.")] = Path("survey"),
    seed: Annotated[int | None, typer.Option(min=0, help="Instead of the plan's.")] = None,
    speed: Annotated[float, typer.Option(min=0.1, max=100.0, help="Speed of the recording.")] = 20.0,
) -> None:
    """Simulate a flight, record it over real ports, process it, compare the results with the truth.

    Example: `python -m photocal.demo -o demo-output`
    """
    if context.invoked_subcommand is None:
        from photocal.demo.simulated import simulated

        simulated(plan, output, seed, speed)


@app.command()
def dcs460(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "demo-output"
    ),
) -> None:
    """Calibrate a Kodak DCS460 from its published observations, import a small flight log.

    Example: `python -m photocal.demo dcs460`
    """
    from photocal.demo.published import published

    published(output)


if __name__ == "__main__":
    run(app)
