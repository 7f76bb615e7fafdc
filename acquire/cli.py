"""The command `acquire`: a list of its commands."""

import os

from acquire.commands import flight_log, recording, simulate
from photocal.base.console import application, run

app = application("Record, import, replay and inspect flights; the flight log is an MCAP file.")
app.command()(recording.check)
app.command()(flight_log.export)
app.command("import")(flight_log.import_)
app.command()(flight_log.info)
app.command()(recording.monitor)
app.command()(recording.record)
app.command()(flight_log.recover)
app.command()(flight_log.replay)
app.add_typer(simulate.app, name="simulate")


def main() -> None:
    """Run the command line."""
    # Nothing here multiplies large matrices: threads for that would cost every command a start.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    run(app)


if __name__ == "__main__":
    main()
