"""The command `acquire`: a list of its commands, each in a module of its own."""

from __future__ import annotations

import os

from acquire.commands import check, export, import_, info, monitor, record, recover, replay, simulate
from acquire.console import application, run

app = application("Record, import, replay and inspect flights; the flight log is an MCAP file.")
app.command()(check.check)
app.command()(export.export)
app.command("import")(import_.import_)
app.command()(info.info)
app.command()(monitor.monitor)
app.command()(record.record)
app.command()(recover.recover)
app.command()(replay.replay)
app.add_typer(simulate.app, name="simulate")


def main() -> None:
    """Run the command line."""
    # Nothing here multiplies large matrices: threads for that would cost every command a start.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    run(app)


if __name__ == "__main__":
    main()
