"""`photocal desk`: one window from the folder to the signed certificate."""

from pathlib import Path
from typing import Annotated

import typer

from photocal.base.console import Address, answer, argument, option


def desk(
    folder: Annotated[Path, argument("Folder of a flight, or a folder that has such folders.")],
    address: Address = "127.0.0.1:8760",
    cache: Annotated[Path | None, option("Folder for tiles; ~/.cache/photocal when not given.")] = None,
    as_json: Annotated[
        bool, option("Print how the steps stand as JSON, and show no window.", "--json")
    ] = False,
) -> None:
    """Open a window on a folder: choose, check, run, look, certify, on a local web page.

    The page runs commands and shows each of them.

    Example: `photocal desk flight`
    """
    from photocal.base.operating_system import cache_folder, stopped_by_signals
    from photocal.base.web import read_address, serving
    from photocal.desk.server import application
    from photocal.desk.session import Desk
    from photocal.desk.standing import shown

    tiles = cache or cache_folder()
    if as_json:
        answer(True, lambda: shown(Desk(folder, tiles)), str)
        return
    stop = stopped_by_signals()
    page = application(folder, tiles)
    with serving(page, read_address(address)) as url:
        typer.echo(f"open {url} (Ctrl-C ends)")
        stop.wait()
