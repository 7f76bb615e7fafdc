"""Study: 24 hours of flight, twenty times as fast, through the recorder.

Writes `docs/evidence/long-flight.md`. The devices of a simulated flight (autopilot by UDP, rover and base
on pseudo terminals) play a day in 72 minutes; `acquire record`, a process of its own, records them as
hardware and begins a new file every two hours of flight. Every frame in the files is compared with what was
sent; memory, descriptors and processor time of the recorder are those that the system tells (proc(5)).

Run: `make evidence`, or `python -m tests.evidence.long_flight [SPEED [HOURS]]`; HOURS is even.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from acquire.log.replay import raw_frames
from acquire.simulate.hardware import awaited, on_ports, record_settings
from acquire.simulate.playback import FlightClock, PlayedFlight, read_flight
from acquire.simulate.world.streams import RecordedWire
from tests.acquire.live import Recorder, free_port

HOURS, SPEED = 24, 20.0
FILE_HOURS = 2
LOOK_EVERY_S = 1.0
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "long-flight.md"
FLIGHT = """
name = "a day over a field"
seed = 9
level = "observations"

[place]
latitude_deg = -25.4483
longitude_deg = -49.2311
height_m = 912.0
crs = "EPSG:31982"
start_utc = 2025-06-15T14:00:00Z

[terrain]
longest_m = 300.0

[plan]
area_m = [[-300.0, -250.0], [300.0, -250.0], [300.0, 250.0], [-300.0, 250.0]]
take_off_m = [-310.0, -255.0]

[camera]
id = "SIM-0"
size_px = [1024, 768]
pitch_mm = 0.0117
nominal_mm = 8.8
fx = 754.3
fy = 753.9
cx = 514.2
cy = 380.9

[rig]
camera_to_antenna_m = [0.08, 0.03, -0.24]

[targets]
control = 4
check = 3
side_m = 1.6

[gnss]
base_m = [-320.0, -260.0]
"""
# The field is flown over once in some two hours.
OVERFLIGHT = """
[[plan.pass]]
height_m = 60.0
course_deg = 90.0
speed_m_s = 2.8
side_overlap = 0.8
"""


@dataclass(frozen=True)
class Compared:
    """A link: frames and bytes sent, frames that are missing in the log, and others than answers."""

    sent: int
    size: int
    missing: int
    foreign: int
    in_order: bool


def flown(folder: Path, hours: int) -> PlayedFlight:
    """Fly, and cut the streams after some hours."""
    path = folder / "flight.toml"
    path.write_text(FLIGHT + OVERFLIGHT * (hours // 2), encoding="utf-8")
    flight = read_flight(path)
    if flight.end_s < hours * 3600:
        raise SystemExit(f"the flight lasts {flight.end_s:.0f} s only")
    lines = {}
    for name, line in flight.lines.items():
        count = int(np.searchsorted(line.arrival_s, hours * 3600))
        lines[name] = RecordedWire(line.arrival_s[:count], line.frames[:count])
    return replace(flight, lines=lines)


def resident_mb(pid: int) -> float:
    """Return what a process holds in memory."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def processor_s(pid: int) -> float:
    """Return the processor time of a process."""
    words = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def descriptors(pid: int) -> int:
    """Return how many files, ports and sockets a process has open."""
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))


def compared(name: str, line: RecordedWire, logs: Iterable[Path]) -> Compared:
    """Compare a link with what was sent; the numbers of an autopilot's frames go on through its answers."""
    found = [frame for log in logs for _, frame in raw_frames(log, name)]
    vehicle = name == "vehicle"
    sent = Counter(map(_content, line.frames) if vehicle else line.frames)
    kept = Counter(map(_content, found) if vehicle else found)
    extra = kept - sent
    if vehicle:
        answers = {0, 77, 111}
        foreign = sum(n for frame, n in extra.items() if int.from_bytes(frame[6:9], "little") not in answers)
        own = [frame[4] for frame in found if frame[5:7] == b"\x01\x01"]
        in_order = all((after - before) % 256 == 1 for before, after in pairwise(own))
    else:
        answers_ubx = {b"\x0a\x04", b"\x05\x01", b"\x06\x8b"}
        foreign = sum(n for frame, n in extra.items() if frame[2:4] not in answers_ubx)
        in_order = [frame for frame in found if frame in sent] == list(line.frames)
    return Compared(
        len(line.frames), sum(map(len, line.frames)), (sent - kept).total(), foreign, in_order=in_order
    )


def _content(frame: bytes) -> bytes:
    """Return a MAVLink 2 frame without its number and its checksum."""
    return frame[:4] + frame[5:-2]


def table(rows: Iterable[tuple[str, str]]) -> list[str]:
    """Return the lines of a table of two columns."""
    return ["| | |", "|---|---|", *(f"| {what} | {figure} |" for what, figure in rows)]


def main() -> None:
    """Run the study and write its page."""
    speed = float(sys.argv[1]) if len(sys.argv) > 1 else SPEED
    hours = int(sys.argv[2]) if len(sys.argv) > 2 else HOURS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        flight = flown(folder, hours)
        sys.stderr.write(f"flying {flight.end_s:.0f} s at {speed:g} times\n")
        clock = FlightClock(awaited(flight), speed)
        memory: list[float] = []
        opened: list[int] = []
        with on_ports(flight, clock, udp_port=free_port()) as urls:
            settings = folder / "record.toml"
            written = record_settings(flight, urls, Path("log"))
            rotation = f"[recording]\nrotate_min = {FILE_HOURS * 60 / speed}\n"
            settings.write_text(written.replace("[recording]\n", rotation), encoding="utf-8")
            with Recorder(settings) as recorder:
                pid, begun = recorder.process.pid, time.monotonic()
                while clock.flight_s() < flight.end_s:
                    time.sleep(LOOK_EVERY_S)
                    memory.append(resident_mb(pid))
                    opened.append(descriptors(pid))
                # What the devices said last is on its way.
                time.sleep(2 * LOOK_EVERY_S)
                lasted, busy = time.monotonic() - begun, processor_s(pid)
                figures = recorder.figures()
        logs = sorted(recorder.path.parent.glob("*.mcap"))
        size_mb = sum(log.stat().st_size for log in logs) / 1e6
        links = {name: compared(name, line, logs) for name, line in flight.lines.items()}
    told = [f"{a['link']} {a['text']}" for a in figures["alarms"] if a["kind"] != "note"]
    # The first tenth is warming up: modules, tables of messages.
    settled = np.array(memory[len(memory) // 10 :])
    quarters = [np.array_split(settled, 4), np.array_split(np.array(opened[len(opened) // 10 :]), 4)]
    lines = [
        f"# {hours} hours of flight through the recorder",
        "",
        f"A simulated flight of {flight.end_s / 3600:.2f} h (autopilot by UDP, rover and base on pseudo",
        f"terminals) is played {speed:g} times as fast and recorded by `acquire record` in a process of",
        f"its own. A new file begins every {FILE_HOURS} hours of flight.",
        "Required: nothing lost, constant memory. Frames are compared with what was sent;",
        "`others` are frames that were neither sent by the flight nor are heartbeats, acknowledgements or",
        "TIMESYNC: of the vehicle, the values of the four parameters that the recorder asks for.",
        "",
        "| link | frames sent | MB | missing | others | in their order |",
        "|---|---|---|---|---|---|",
        *(
            f"| {name} | {c.sent:,} | {c.size / 1e6:.1f} | {c.missing} | {c.foreign} | "
            f"{'yes' if c.in_order else 'no'} |"
            for name, c in links.items()
        ),
        "",
        *table(
            [
                ("the recording took", f"{lasted:.0f} s"),
                ("files, MB", f"{len(logs)}, {size_mb:.0f}"),
                ("bytes of damage", f"{sum(link['damage_bytes'] for link in figures['links'])}"),
                ("alarms", "; ".join(told) or "none"),
                (
                    "memory in each quarter, greatest",
                    ", ".join(f"{part.max():.1f}" for part in quarters[0]) + " MB",
                ),
                ("memory at the end against the first tenth", f"{settled[-1] / settled[0] - 1:+.1%}"),
                ("descriptors in each quarter, greatest", ", ".join(f"{part.max()}" for part in quarters[1])),
                ("processor time", f"{100 * busy / lasted:.0f} % of one core"),
            ]
        ),
        "",
        "Made by `python -m tests.evidence.long_flight`.",
        "",
    ]
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")
    sys.stderr.write("\n".join(lines))


if __name__ == "__main__":
    main()
