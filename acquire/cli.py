"""The command `acquire`: a list of its commands."""

import os

from photocal.base.console import Listed, application, run

COMMANDS = {
    "check": Listed(
        "acquire.commands.recording:check",
        "Check ports, heartbeats, fix, rates, disk space and clock before a flight.",
    ),
    "export": Listed(
        "acquire.commands.flight_log:export",
        "Write the vehicle's link as a telemetry log that ground stations and pymavlink read.",
    ),
    "import": Listed(
        "acquire.commands.flight_log:import_",
        "Import recordings into one flight log, raw first.",
    ),
    "info": Listed(
        "acquire.commands.flight_log:info",
        "Say whether a flight log is complete and can be processed; show its links, gaps, fixes and clocks.",
    ),
    "monitor": Listed(
        "acquire.commands.recording:monitor",
        "Show fix, satellites, corrections, rates, pictures, disk, clock and alarms of a recording live.",
    ),
    "record": Listed(
        "acquire.commands.recording:record",
        "Record all links until Ctrl-C; the file is safe on disk at least once a second.",
    ),
    "recover": Listed(
        "acquire.commands.flight_log:recover",
        "Save every intact chunk of a flight log that was truncated or damaged.",
    ),
    "replay": Listed(
        "acquire.commands.flight_log:replay",
        "Send the raw frames of a link, byte for byte and in their order.",
    ),
    "simulate": Listed(
        "acquire.commands.simulate:app",
        "Simulate flights: their telemetry, a whole survey with its truth, devices on ports.",
    ),
}
app = application("Record, import, replay and inspect flights; the flight log is an MCAP file.", COMMANDS)


def main() -> None:
    """Run the command line."""
    # Nothing here multiplies large matrices: threads for that would cost every command a start.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    run(app)


if __name__ == "__main__":
    main()
