"""`python -m photocal.demo`: what `make demo` and `make demo-dcs460` run."""

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from photocal.base.console import application, run
from photocal.findings.texts import catalogue

_DATA = Path(__file__).parent
app = application("Demonstrations: a simulated flight with known truth, a camera of a published study.")


def calibrate(block: Path, output: Path) -> None:
    """Adjust a block into `run` and write its `certificate`, which prints what it says."""
    from photocal.block.results.adjusted import adjust_block
    from photocal.report.options import CertificateOptions
    from photocal.run.certify import certificate

    adjust_block(block, output / "run")
    typer.echo(
        str(certificate(output / "run", output / "certificate", options=CertificateOptions(block=block)))
    )


def fly(recording: Path, output: Path) -> tuple[str, ...]:
    """Import a recording as flight log and say in three lines what it holds."""
    from acquire.channels.summary import summarise
    from acquire.importing.importer import import_recordings

    import_recordings([], [recording], output / "flight.mcap", lambda _: None)
    return tuple(_lines(summarise(output / "flight.mcap")))


def _lines(figures: dict[str, Any]) -> list[str]:
    link = figures["links"][0]
    frames = {kind["type"]: kind["frames"] for kind in link["types"]}
    fixes = [f"{name} {count}" for counts in figures["fixes"].values() for name, count in counts.items()]
    amount = f"{link['frames']} frames in {link['duration_s']:.1f} s"
    return [
        f"{link['link']}: {amount}, {link['damage_bytes']} bytes belong to no valid frame",
        f"position fixes: {', '.join(fixes)}",
        f"exposures: {frames.get('CAMERA_FEEDBACK', 0)}; clock: {link['clock']['verdict']}",
    ]


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
    began = time.monotonic()
    typer.echo("Calibration of a Kodak DCS460 from its published observations\n")
    calibrate(_DATA / "dcs460", output)
    typer.echo("\nFlight log. The flight is SYNTHETIC, made by the project's own encoder\n")
    typer.echo("\n".join(f"  {line}" for line in fly(_DATA / "flight" / "flight.tlog", output)))
    typer.echo(f"\nThe certificate: {output / 'certificate' / 'certificate.html'}, the same as .pdf")
    typer.echo(f"The flight log, for Foxglove or Lichtblick: {output / 'flight.mcap'}")
    typer.echo(f"Done in {time.monotonic() - began:.1f} s.")


if __name__ == "__main__":
    run(app, catalogue, "photocal.commands")
