"""The recording itself: one thread per link reads, one writes; the file is safe at least once a second."""

import math
import mimetypes
import os
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from acquire.channels.link import Tally
from acquire.log.writer import LogWriter
from acquire.recording.alarms import (
    LEAST_JUMP_S,
    Alarm,
    AlarmLimit,
    RecordingWatch,
    write_alarms,
)
from acquire.recording.caster_position import CasterPosition, caster_positions
from acquire.recording.configuration import LinkConfiguration, RecordingConfiguration
from acquire.recording.device_line import Outlet
from acquire.recording.files import LogFiles, Notice
from acquire.recording.link_session import LinkSession, link_sessions
from acquire.recording.log_file import WholeWrites, new_file, unclosed
from acquire.recording.reader import Inbox, left_behind, start_readers
from acquire.transports.ntrip import NtripSource, ntrip_address
from acquire.transports.sources import Source, source_of
from drivers.mavlink.dialect import ardupilotmega
from drivers.scan import compile_search
from photocal.base.errors import ConfigurationError, InputNotFoundError, reason
from photocal.base.time_scales import expiry_warning
from photocal.base.version import __version__

CHUNK_BYTES = 1 << 20
# How much of a link is framed before it is the turn of the next.
BUDGET_BYTES = 1 << 17
# How long the last words may take: a terminal that is paused takes none.
LAST_WORDS_S = 0.15
_MB = 1_000_000


@dataclass(frozen=True)
class Host:
    """What a recording takes from the computer that it runs on.

    clock_ns: UTC, nanoseconds since 1970.
    steady_s: A clock that never jumps, seconds.
    free_bytes: free space where a folder lies.
    """

    clock_ns: Callable[[], int] = time.time_ns
    steady_s: Callable[[], float] = time.monotonic
    free_bytes: Callable[[Path], int] = lambda folder: shutil.disk_usage(folder).free
    make: Callable[[Path], WholeWrites] = new_file


@dataclass(frozen=True)
class Recorded:
    """What was recorded: the files that there are, frames and damage of each link, and the alarms.

    untold: number of lines that the terminal did not take.
    """

    paths: tuple[Path, ...]
    tallies: dict[str, Tally]
    alarms: tuple[Alarm, ...]
    untold: int = 0


def record(
    configuration: RecordingConfiguration,
    base: Path,
    stop: threading.Event,
    tell: Callable[[str], None],
    host: Host | None = None,
    sources: dict[str, Source] | None = None,
) -> Recorded:
    """Record all links until told to stop.

    tell: takes lines for a person, in a thread of its own: it may wait or fail, recording goes on.

    raises OutputError: when the log cannot be written (any more); what was written before stays.
    raises ConfigurationError: when an address is not valid.
    raises InputNotFoundError: when a file to be attached cannot be read.
    """
    # Where nothing waits, bytes gather for this long: fewer, larger writes.
    gather_s = 0.02
    # How long a stop may wait for ports that hang, and for what waits for being framed.
    limit_s = 0.6
    host = host or Host()
    dialect = ardupilotmega()
    positions = caster_positions(configuration, dialect)
    opened = sources or sources_of(configuration, positions, host.clock_ns)
    attached = _attachments(configuration, base)
    chosen = configuration.recording

    def begin(writer: LogWriter) -> None:
        """Write into a new file what describes the recording."""
        writer.metadata("software", {"name": "photocal acquire", "version": __version__})
        writer.metadata("recording", {"flush_s": f"{chosen.flush_s:g}"})
        if texts := configuration.site.texts():
            writer.metadata("site", texts)
        for name, content in attached:
            kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
            writer.attachment(name, kind, content, host.clock_ns())

    folders = [base / folder for folder in (chosen.output, *chosen.spare)]
    before = [path for folder in folders for path in unclosed(folder)]
    files = LogFiles(
        folders,
        begin,
        host.clock_ns,
        host.make,
        host.steady_s,
        most_bytes=round(chosen.rotate_mb * _MB),
        most_s=chosen.rotate_min * 60,
    )
    lines = Outlet("terminal", tell)
    lines.put(f"recording to {files.paths[0]}")
    for path in before:
        lines.put(
            f"{path} was not closed: if it belongs to this flight, name both in [flight] logs of the project"
        )
    if warning := expiry_warning(host.clock_ns()):
        lines.put(f"warning: {warning}")
    compile_search()
    clocks = host.clock_ns, host.steady_s
    sessions = link_sessions(configuration, files.messages, opened, positions, dialect, *clocks)
    flight = _Flight(configuration, files, sessions, host, lines.put)
    inboxes, readers = start_readers(opened, stop, host.clock_ns)
    try:
        while not stop.is_set():
            # Many small arrivals are framed together: that is what makes high rates cheap.
            stop.wait(0.0 if flight.step(inboxes) else gather_s)
        for name in left_behind(readers, limit_s / 2):
            tell(f"{name} does not stop and was abandoned")
        # What arrived between the order to stop and the end of the readers belongs to the flight, too.
        flight.close(inboxes, limit_s)
    except BaseException:
        stop.set()
        left_behind(readers, limit_s / 2)
        lines.close(LAST_WORDS_S)
        raise
    lines.close(LAST_WORDS_S)
    tallies = {name: session.log.tally for name, session in flight.sessions.items()}
    return Recorded(tuple(files.existing()), tallies, tuple(flight.alarms), lines.dropped + lines.failed)


def source_of_link(
    link: LinkConfiguration,
    environment: Mapping[str, str] = os.environ,
    position: Callable[[], bytes] | None = None,
) -> Source:
    """Return the source of a link."""
    address = ntrip_address(link.url)
    if address is None:
        return source_of(link.url, link.baud)
    if link.password_env and link.password_env not in environment:
        raise ConfigurationError(
            f"the environment variable {link.password_env} with the password is not set",
            "set it before recording",
            where=link.url,
        )
    return NtripSource(address, link.user, environment.get(link.password_env, ""), position=position)


def sources_of(
    configuration: RecordingConfiguration, positions: dict[str, CasterPosition], clock_ns: Callable[[], int]
) -> dict[str, Source]:
    """Return the sources of all links; the request to a caster contains its position.

    raises ConfigurationError: when an address is not valid or a password is missing.
    """
    sentences = {name: position.now(clock_ns) for name, position in positions.items()}
    return {link.name: source_of_link(link, position=sentences.get(link.name)) for link in configuration.link}


class _Flight:
    """The writing side: takes what has arrived, watches, answers, and keeps the files safe."""

    def __init__(
        self,
        configuration: RecordingConfiguration,
        files: LogFiles,
        sessions: dict[str, LinkSession],
        host: Host,
        tell: Callable[[str], None],
    ) -> None:
        # Alarms that are kept for the figures at the end; the log has all.
        most_alarms = 2000
        self.sessions = sessions
        self.alarms: deque[Alarm] = deque(maxlen=most_alarms)
        self._recording = configuration.recording
        self._files = files
        self._host = host
        self._tell = tell
        now = host.steady_s()
        self._limit = AlarmLimit()
        self._raised = 0
        self._watch = RecordingWatch({link.name: link.silent_s for link in configuration.link}, now)
        self._safe_at = now + self._recording.flush_s
        self._disk_at = now
        self._disk_announced = False
        # A folder on another computer may take its time to say how much room it has.
        self._looks: Outlet[Path] = Outlet("disk room", self._look_at_disk, 1)
        self._free_mb: float | None = None

    def step(self, inboxes: dict[str, Inbox]) -> bool:
        """Take of each link what the budget allows and do what is due; tell whether something is left."""
        now = self._host.steady_s()
        self._take(inboxes, now)
        clock_ns = self._host.clock_ns()
        self._raise(
            [
                *self._jump(),
                *self._watch.silences(now, clock_ns),
                *self._disk(now),
                *self._watch.floods(inboxes, now, clock_ns),
            ]
        )
        if self._files.open_bytes > CHUNK_BYTES:
            self._report(self._files.end_chunk())
        if now >= self._safe_at or self._files.flush_overdue:
            self._safe_at = now + self._recording.flush_s
            self._keep(inboxes)
            self._report(self._files.make_safe())
        return any(map(len, inboxes.values()))

    def close(self, inboxes: dict[str, Inbox], patience_s: float) -> None:
        """Take the last arrivals, as long as there is time, and close the files."""
        until = time.monotonic() + patience_s
        while any(map(len, inboxes.values())) and time.monotonic() < until:
            self._take(inboxes, self._host.steady_s())
        self._raise(self._watch.floods(inboxes, math.inf, self._host.clock_ns()))
        for name, session in self.sessions.items():
            if len(inboxes[name]):
                text = "some data were not framed before the end: acquire recover frames the rest"
                self._raise([Alarm("flood", name, text, self._host.clock_ns())])
            else:
                session.close()
            # What a device has not taken by now it does not get: the stop waits for none.
            session.log_sent()
            self._raise(session.device.alarms(math.inf))
        self._keep(inboxes)
        self._raise([], last=True)
        # The log is closed by then: these are reported, and kept for the figures.
        notices = self._files.close()
        ended = [Alarm(kind, "", text, self._host.clock_ns()) for kind, text in notices]
        for alarm in ended:
            self._tell(str(alarm))
        self.alarms.extend(ended)

    def _keep(self, inboxes: dict[str, Inbox]) -> None:
        """Write what waits for being framed as it is, in a chunk of its own."""
        waiting = {name: inbox.unsaved() for name, inbox in inboxes.items()}
        if any(waiting.values()):
            self._report(self._files.end_chunk())
            for name, arrivals in waiting.items():
                self.sessions[name].keep(arrivals)
            self._report(self._files.end_chunk())

    def _take(self, inboxes: dict[str, Inbox], now: float) -> None:
        clock_ns = self._host.clock_ns()
        for name, session in self.sessions.items():
            arrivals = inboxes[name].take(BUDGET_BYTES)
            self._raise([Alarm(a.kind, a.link, a.event, a.time_ns) for a in arrivals if a.event])
            taken = [arrival for arrival in arrivals if arrival.data]
            batch = session.take(taken) if taken else None
            if batch is not None and len(batch):
                self._raise(self._watch.hear(name, now, clock_ns))
            self._raise(session.converse(batch, now, clock_ns))

    def _jump(self) -> list[Alarm]:
        """Look for a jump of the clock; a pause between the readings of two clocks would look like one."""
        before = self._host.steady_s()
        clock_ns = self._host.clock_ns()
        after = self._host.steady_s()
        return self._watch.jump(clock_ns, before) if after - before < LEAST_JUMP_S / 5 else []

    def _look_at_disk(self, folder: Path) -> None:
        """Ask how much room there is; runs in the thread of its outlet."""
        self._free_mb = self._host.free_bytes(folder) / _MB

    def _disk(self, now: float) -> list[Alarm]:
        # Free space changes slowly.
        look_at_disk_every_s = 5.0
        if now >= self._disk_at:
            self._disk_at = now + look_at_disk_every_s
            self._looks.put(self._files.paths[-1].parent)
        free_mb, self._free_mb = self._free_mb, None
        if free_mb is None:
            return []
        low = free_mb < self._recording.least_free_mb
        was_low, self._disk_announced = self._disk_announced, low
        if not low or was_low:
            return []
        return [Alarm("disk_low", "", f"only {free_mb:.0f} MB are left on the disk", self._host.clock_ns())]

    def _report(self, notices: list[Notice]) -> None:
        self._raise([Alarm(kind, "", text, self._host.clock_ns()) for kind, text in notices])

    def _raise(self, alarms: list[Alarm], *, last: bool = False) -> None:
        passed = self._limit.take(alarms, math.inf if last else self._host.steady_s())
        for alarm in passed:
            self._tell(str(alarm))
        write_alarms(self._files.messages, passed, self._raised)
        self.alarms.extend(passed)
        self._raised += len(passed)


def _attachments(configuration: RecordingConfiguration, base: Path) -> list[tuple[str, bytes]]:
    attachments = []
    for path in configuration.site.files():
        try:
            attachments.append((path.name, (base / path).read_bytes()))
        except OSError as refusal:
            raise InputNotFoundError(
                f"cannot be attached ({reason(refusal)})", "check the name in [site]", where=base / path
            ) from refusal
    return attachments
