"""`photocal adjust`: least squares adjustment of a block."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from acquire.console import answer
from drivers.errors import ConfigurationError
from photocal.commands.options import argument, option


def adjust(
    block: Annotated[
        Path,
        argument(
            "Block folder (block.toml, images.csv, points.csv, observations.csv), or a set-up file of "
            "another program (DBAT, JAICOV)."
        ),
    ],
    output: Annotated[Path, option("Folder for the results.", "-o", "--output")],
    snoop: Annotated[
        str, option("Search for gross errors: `w` (a priori sigmas) or `tau` (a posteriori).")
    ] = "",
    ellipses: Annotated[
        float | None, option("Write error ellipses and ellipsoids of this probability, such as 0.95.")
    ] = None,
    reliability: Annotated[
        bool, option("Write the smallest errors that the tests find.", "--reliability")
    ] = False,
    components: Annotated[
        bool, option("Estimate the sigma of each group of observations and use it.", "--components")
    ] = False,
    joint: Annotated[
        str, option("Write the joint covariance of `image:NAME,point:NAME,camera:ID,head:CAMERA,mounting`.")
    ] = "",
    as_json: Annotated[bool, option("Print result.json instead of a summary.", "--json")] = False,
) -> None:
    """Adjust a block: camera, orientations and points with their complete statistics.

    Example: `photocal adjust my-block -o run`
    """
    from photocal.exchange.formats import read_any_block
    from photocal.results.adjusted import adjust_block
    from photocal.results.folder import result_json
    from photocal.results.more_tables import Wanted, parse_joint

    if snoop not in ("", "w", "tau"):
        raise ConfigurationError(f"--snoop {snoop} is not known", remedy="use w or tau")
    test = cast("Literal['w', 'tau'] | None", snoop or None)
    if ellipses is not None and not 0 < ellipses < 1:
        raise ConfigurationError(f"--ellipses {ellipses:g} is no probability", remedy="give 0.95 for 95 %")
    wanted = Wanted(ellipses, reliability, components, parse_joint(joint))
    with iteration_lines("adjusting") as report:
        result = adjust_block(block, output, test, report, wanted, read_any_block)
    answer(as_json, lambda: result_json(result), lambda: f"{result!r}\nwritten to {output}")


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
