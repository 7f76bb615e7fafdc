"""`photocal adjust`: least squares adjustment of a block."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import typer

from acquire.console import answer
from drivers.errors import ConfigurationError


def adjust(
    block: Annotated[
        Path,
        typer.Argument(
            help="Block folder (block.toml, images.csv, points.csv, observations.csv), or a set-up file of "
            "another program (DBAT, JAICOV)."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")],
    snoop: Annotated[
        str, typer.Option(help="Search for gross errors: `w` (a priori sigmas) or `tau` (a posteriori).")
    ] = "",
    ellipses: Annotated[
        float | None,
        typer.Option(help="Write error ellipses and ellipsoids of this probability, such as 0.95."),
    ] = None,
    reliability: Annotated[
        bool, typer.Option("--reliability", help="Write the smallest errors that the tests find.")
    ] = False,
    components: Annotated[
        bool,
        typer.Option("--components", help="Estimate the sigma of each group of observations and use it."),
    ] = False,
    joint: Annotated[
        str,
        typer.Option(help="Write the joint covariance of `image:NAME,point:NAME,camera:ID,mounting`."),
    ] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print result.json instead of a summary.")] = False,
) -> None:
    """Adjust a block: camera, orientations and points with their complete statistics.

    Example: `photocal adjust my-block -o run`
    """
    from photocal.block.more_tables import Wanted, parse_joint
    from photocal.block.process import adjust_block
    from photocal.exchange.any_block import read_any_block

    if snoop not in ("", "w", "tau"):
        raise ConfigurationError(f"--snoop {snoop} is not known", remedy="use w or tau")
    test = cast("Literal['w', 'tau'] | None", snoop or None)
    if ellipses is not None and not 0 < ellipses < 1:
        raise ConfigurationError(f"--ellipses {ellipses:g} is no probability", remedy="give 0.95 for 95 %")
    wanted = Wanted(ellipses, reliability, components, parse_joint(joint))
    with iteration_lines("adjusting") as report:
        result = adjust_block(block, output, test, report, wanted, read_any_block)
    answer(as_json, lambda: result, lambda: _text(result, output))


@contextmanager
def iteration_lines(title: str) -> Iterator[Callable[[Any], None]]:
    """Show each iteration on standard error when a person watches and it takes more than a second."""
    began = time.monotonic()

    def line(iteration: Any) -> None:
        if sys.stderr.isatty() and time.monotonic() - began > 1.0:
            sys.stderr.write(
                f"{title}: iteration {iteration.number}, chi-squared {iteration.chi_squared:.6g}, "
                f"step {iteration.decrement**0.5:.2g} sigma\n"
            )

    yield line


def _text(result: dict[str, Any], output: Path) -> str:
    """What a person wants to know first."""
    test = result["global_test"]
    counts = (
        f"{result['observations']} observations, {result['unknowns']} unknowns, "
        f"{result['degrees_of_freedom']} degrees of freedom"
    )
    lines = [f"{result['block']['name']}: converged after {result['iterations']} iterations, {counts}"]
    if test:
        verdict = "accepted" if test["accepted"] else "REJECTED"
        lines.append(
            f"chi-squared {result['chi_squared']:.2f}, expected {test['lower']:.1f} to {test['upper']:.1f} "
            f"(95 %): {verdict}; a posteriori variance factor {result['sigma0_squared']:.4f}"
        )
    for name, camera in result["cameras"].items():
        lines.append(f"camera {name} ({camera['model']}, {camera['unit']})")
        for parameter, figures in camera["parameters"].items():
            if figures["estimated"]:
                lines.append(f"  {parameter:<3}{figures['value']:>15.8g}  +- {figures['sigma']:.3g}")
    lines += [
        f"sigma of {one['name']}: {one['factor']:.3f} +- {one['sigma']:.3f} times the given one"
        for one in result["variance_components"]
        if one["estimated"]
    ]
    if result["rejected"]:
        lines.append(f"{len(result['rejected'])} observation(s) rejected as gross errors")
    checks = result["checks"]
    if checks["n"]:
        rmse = ", ".join(f"{axis} {value * 1000:.1f}" for axis, value in checks["rmse_m"].items())
        lines.append(f"check points: {checks['n']}, RMSE {rmse} mm")
    lines.append(f"written to {output}")
    return "\n".join(lines)
