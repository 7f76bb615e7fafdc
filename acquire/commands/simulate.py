"""`acquire simulate`: flights that never took place."""

from pathlib import Path
from typing import Annotated, get_args

import typer

from acquire.commands.texts import texts
from photocal.base.console import AsJson, Language, answer, application, argument, option, refuse_before
from photocal.base.errors import ConfigurationError, OutputError
from photocal.base.progress_bars import progress
from photocal.base.sentences import spoken

FAULTS = (
    "Switch on a fault; may be repeated: wrong_antenna_height, base_off, event_time_base, late_shutter, "
    "lever_arm_axis, zoom, control_digits, missing_images, telemetry_gap, cycle_slips."
)
app = application(
    "Simulate flights: their telemetry, a whole survey with its truth, devices on ports.",
    {
        "flight": "acquire.commands.simulate:flight",
        "serve": "acquire.commands.simulate:serve",
    },
)


@app.callback(invoke_without_command=True)
def simulate(
    context: typer.Context,
    output: Annotated[
        Path | None, option("Telemetry log of a short flight to write (.tlog).", "-o", "--output")
    ] = None,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Write the telemetry log of the flight `small`, which never took place: the same bytes each time.

    Example: `acquire simulate -o flight.tlog`
    """
    if context.invoked_subcommand is not None:
        if output is not None or language or as_json:
            refuse_before(context)
        return
    if output is None:
        raise ConfigurationError("nothing to write", "give -o FILE.tlog, or a command, see --help")
    from acquire.simulate.world.configuration import FLIGHTS, read_configuration
    from acquire.simulate.world.streams import telemetry_log, vehicle_wire
    from acquire.simulate.world.telemetry import LABEL
    from acquire.simulate.world.world import make_world
    from photocal.base.files import output_file

    say = texts(spoken(language))
    world = make_world(read_configuration(FLIGHTS / "small.toml"))
    log = telemetry_log(world, vehicle_wire(world, world.random("wires")))
    with output_file(output) as aside:
        aside.write_bytes(log)
    answer(
        as_json,
        lambda: {"schema": "acquire.simulate/1", "output": str(output), "bytes": len(log), "label": LABEL},
        lambda: say("simulate.wrote", path=output, size=len(log)),
    )


def flight(
    configuration: Annotated[
        Path,
        argument(
            "Plan of the flight; `small`, `survey` and `drone` are shipped.", metavar="CONFIG.toml|NAME"
        ),
    ],
    output: Annotated[Path, option("Folder to make, with site/ and truth/.", "-o", "--output")],
    level: Annotated[
        str | None, option("What is simulated: pictures, observations, block or card; overrides the plan.")
    ] = None,
    observations_only: Annotated[
        bool, option("The same as --level block: fast, for statistics.", "--observations-only")
    ] = False,
    seed: Annotated[int | None, option("Random seed; overrides the plan.", min=0)] = None,
    fault: Annotated[list[str] | None, option(FAULTS)] = None,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Simulate a survey flight: what a surveyor brings home in site/, the truth in truth/.

    Example: `acquire simulate flight survey -o flight`
    """
    from acquire.simulate.world.configuration import Level, SimulatedFault, read_configuration
    from acquire.simulate.world.site import simulate_flight
    from photocal.base.files import output_folder

    if output.is_dir() and any(output.iterdir()):
        # Files of another flight between the new ones would be taken for its own.
        raise OutputError("is not empty", "name a new folder", where=output)
    for given, kinds in ((level, get_args(Level)), *((one, get_args(SimulatedFault)) for one in fault or [])):
        if given is not None and given not in kinds:
            raise ConfigurationError(f"{given!r} is not known", f"choose one of {', '.join(kinds)}")
    chosen = {
        "level": "block" if observations_only else level,
        "seed": seed,
        "faults": frozenset(fault) if fault else None,
    }
    say = texts(spoken(language))
    left = say.messages["progress.left"]
    plan = read_configuration(configuration, {k: v for k, v in chosen.items() if v is not None})
    with progress(say("progress.simulating"), 1.0, left) as advance, output_folder(output) as aside:
        figures = simulate_flight(plan, aside, advance)
    answer(
        as_json,
        lambda: {"schema": "acquire.simulate.flight/1", "output": str(output), **figures},
        lambda: say(
            "simulate.flight",
            path=output,
            images=figures["images"],
            control=figures["control"],
            check=figures["check"],
            duration=f"{figures['duration_s']:.0f}",
            faults=say("simulate.faults", names=", ".join(figures["faults"])) if figures["faults"] else "",
        ),
    )


def serve(
    flown: Annotated[
        Path, argument("A simulated flight with streams, or its plan.", metavar="DIR|CONFIG.toml")
    ],
    speed: Annotated[float, option("Speed factor.", min=0.01, max=100)] = 1.0,
    record: Annotated[
        Path | None,
        option("Configuration for `acquire record` to write; without: record.toml in site/.", metavar="FILE"),
    ] = None,
    udp_port: Annotated[
        int, option("Port to which the vehicle sends; 0: any free port.", min=0, max=65535)
    ] = 0,
    base_on_tcp: Annotated[
        bool, option("Simulate the base as a TCP server instead of a serial port.", "--base-on-tcp")
    ] = False,
    at_once: Annotated[
        bool, option("Begin immediately, without waiting for the recorder.", "--at-once")
    ] = False,
    now: Annotated[
        bool,
        option("For practice: fly the plan with all clocks set to now; begins in a minute.", "--now"),
    ] = False,
    linger: Annotated[float, option("Seconds to stay after the end.", min=0)] = 3.0,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Play a simulated flight on real ports: the vehicle by UDP, receivers on pseudo terminals.

    The flight begins when `acquire record` has connected to the devices.

    Example: `acquire simulate serve flight --speed 10`, beside it `acquire record flight/site/record.toml`

    To practise with recorder and monitor: `acquire simulate serve small --now`
    """
    # How long after the start a flight with the clocks of now begins: the recorder is started meanwhile.
    lead_s = 60
    import datetime as dt
    import time

    from acquire.simulate.hardware import awaited, on_ports, record_settings
    from acquire.simulate.playback import FlightClock, read_flight
    from photocal.base.files import output_file

    say = texts(spoken(language))
    start_s = time.time() + lead_s
    if now and speed != 1:
        raise ConfigurationError("with --now the clocks cannot run faster", "leave out --speed or --now")
    flight = read_flight(flown, dt.datetime.fromtimestamp(start_s, dt.UTC) if now else None)
    if now and time.time() > start_s:
        raise ConfigurationError(
            f"took longer than {lead_s} s to simulate", "practise with a smaller plan", where=flown
        )
    settings = record or (flown / "site" / "record.toml" if flown.is_dir() else Path("record.toml"))
    waits = () if at_once else awaited(flight, base_on_tcp=base_on_tcp)
    begins_s = time.monotonic() + start_s - time.time() if now else None
    clock = FlightClock(waits, speed, begins_s=begins_s)
    end_s = flight.end_s
    with on_ports(flight, clock, udp_port=udp_port, base_on_tcp=base_on_tcp) as urls:
        text = record_settings(flight, urls, Path("recording"))
        with output_file(settings) as aside:
            aside.write_text(text, encoding="utf-8")
        figures = {
            "schema": "acquire.simulate.hardware/1",
            "record": str(settings),
            "flight_s": end_s,
            **urls,
        }
        answer(
            as_json,
            lambda: figures,
            lambda: "\n".join(
                [*(f"{name}: {url}" for name, url in urls.items()), f"acquire record {settings}"]
            ),
        )
        if now:
            typer.echo(say("simulate.begins", seconds=round(start_s - time.time())), err=True)
        elif waits:
            typer.echo(say("simulate.waits"), err=True)
        with progress(say("progress.flying"), end_s, say.messages["progress.left"]) as advance:
            shown = 0.0
            while shown < end_s:
                time.sleep(0.05)
                flown_s = min(max(clock.flight_s(), 0.0), end_s)
                advance(flown_s - shown)
                shown = flown_s
        typer.echo(say("simulate.flown", duration=f"{end_s:.0f}"), err=True)
        time.sleep(linger)
