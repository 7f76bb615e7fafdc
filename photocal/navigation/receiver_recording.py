"""What a GNSS receiver left in a flight log: observations and ephemerides, in intact frames only."""

from dataclasses import dataclass, field, fields, replace
from functools import lru_cache

import numpy as np

from acquire.log.reader import LoggedMessages, link_of
from drivers.frames import Batch, Wire
from drivers.identify import batch_of_payloads
from drivers.mavlink.dialect import Dialect
from drivers.protocols import protocol_of, receiver_wires
from drivers.receiver import TimeMarks
from drivers.rtcm3 import decode_stations
from drivers.ubx import decode as ubx
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.base.time_scales import week_to_ns
from photocal.navigation.events import logged_exposures
from photocal.navigation.flight_log import FlightLog

_MSM_FIRST, _MSM_LAST = 1071, 1137
_NO_DIALECT = Dialect({}, {})


@dataclass
class ReceiverRecording:
    """Frames of one link of a flight log that bear on its position.

    ubx, rtcm: RXM-RAWX with a time and at least one signal, and RXM-SFRBX; all RTCM 3 frames.
    epochs, empty_epochs, untimed_epochs: RXM-RAWX used, without signals, and of week 0.
    announced_m (3,): Earth-centred positions in RTCM 1005/1006.
    surveyed_m (3,): mean of a survey-in that is valid.
    surveyed_sigma_m: its accuracy as the receiver states it, in space.
    first_log_ns: time of receipt of the first frame (UTC ns).
    time_marks, mark_source: edges, each with the number of its frame, and the message that told them.
    logged: numbers of the frames whose edges were decoded when they were logged.
    epoch_ns, epoch_log_ns, epoch_number: the epochs used (GPS ns), their arrival (UTC ns), their frames.
    geoid_m: height above the ellipsoid less height above sea level, as NAV-PVT or GGA told it.
    """

    link: str
    logged: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    ubx: list[bytes] = field(default_factory=list)
    rtcm: list[bytes] = field(default_factory=list)
    epochs: int = 0
    empty_epochs: int = 0
    untimed_epochs: int = 0
    ephemeris_frames: int = 0
    observation_frames: int = 0
    announced_m: list[Floats] = field(default_factory=list)
    surveyed_m: Floats | None = None
    surveyed_sigma_m: float | None = None
    first_log_ns: int = 0
    time_marks: list[TimeMarks] = field(default_factory=list)
    mark_source: str = ""
    epoch_ns: list[Integers] = field(default_factory=list)
    epoch_log_ns: list[Integers] = field(default_factory=list)
    epoch_number: list[Integers] = field(default_factory=list)
    geoid_m: list[float] = field(default_factory=list)

    def add(self, wire: Wire, messages: LoggedMessages) -> None:
        """Take the frames of one chunk of the log."""
        payloads, protocol = messages.payloads, protocol_of(wire)
        batch = batch_of_payloads(wire, payloads, _NO_DIALECT)
        for fixes in protocol.fixes(batch).values():
            self.geoid_m.extend(fixes.geoid_m[fixes.valid & np.isfinite(fixes.geoid_m)].tolist())
        if wire == Wire.UBX:
            self._add_ubx(batch, messages)
        elif wire == Wire.RTCM3:
            self.rtcm.extend(payloads)
            self.announced_m.extend(decode_stations(batch)["ecef_m"])
            self.ephemeris_frames += int(np.isin(batch.kind, (1019, 1020, 1042, 1044, 1045, 1046)).sum())
            observing = (batch.kind >= _MSM_FIRST) & (batch.kind <= _MSM_LAST)
            self.observation_frames += int((observing | np.isin(batch.kind, (1002, 1004, 1010, 1012))).sum())
        left = replace(batch, known=batch.known & ~np.isin(messages.sequence, self.logged))
        for source, marks in protocol.time_marks(left).items():
            if len(marks.index):
                self.mark_source = source
                self.time_marks.append(replace(marks, index=messages.sequence[marks.index]))

    def _add_ubx(self, batch: Batch, messages: LoggedMessages) -> None:
        raw = ubx.decode_rawx(batch)
        empty = raw.fields["numMeas"] == 0
        untimed = ~empty & ((raw.fields["week"] == 0) | ~np.isfinite(raw.fields["rcvTow"]))
        used = ~empty & ~untimed
        good = raw.index[used]
        self.epochs += len(good)
        self.empty_epochs += int(empty.sum())
        self.untimed_epochs += int(untimed.sum())
        subframes = ubx.decode(batch, ubx.RXM_SFRBX).index
        self.ephemeris_frames += len(subframes)
        self.ubx.extend(messages.payloads[i] for i in np.sort(np.concatenate([good, subframes])).tolist())
        survey = ubx.decode(batch, ubx.NAV_SVIN).fields
        survey = survey[(survey["valid"] != 0) & (survey["obs"] > 0)]
        if len(survey):
            last = survey[-1]
            mean = [float(last[f"mean{a}"]) * 1e-2 + float(last[f"mean{a}HP"]) * 1e-4 for a in "XYZ"]
            self.surveyed_m = np.array(mean)
            self.surveyed_sigma_m = float(last["meanAcc"]) * 1e-4
        if len(good):
            self.epoch_ns.append(week_to_ns(raw.fields["week"][used], raw.fields["rcvTow"][used]))
            self.epoch_log_ns.append(messages.log_ns[good])
            self.epoch_number.append(messages.sequence[good])

    def epochs_and_arrivals(self) -> tuple[Integers, Integers]:
        """Return the epochs used (GPS ns) and their arrival (UTC ns)."""
        if not self.epoch_ns:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        return np.concatenate(self.epoch_ns), np.concatenate(self.epoch_log_ns)

    def marks(self) -> TimeMarks:
        """Return all time marks in the order of the stream."""
        none = [np.empty(0, kind) for kind in (int, bool, int, int, int, bool, int)]
        parts = [[getattr(marks, f.name) for f in fields(marks)] for marks in self.time_marks] or [none]
        marks = TimeMarks(*map(np.concatenate, zip(*parts, strict=True)))
        return marks.rows(np.argsort(marks.index, kind="stable"))

    def epochs_before_marks(self) -> Integers:
        """Return the epoch before each time mark in the stream (GPS ns); -1 before the first."""
        epochs, numbers = np.concatenate([[-1], *self.epoch_ns]), np.concatenate([[-1], *self.epoch_number])
        return np.asarray(epochs[np.searchsorted(numbers, self.marks().index) - 1], np.int64)

    def position_m(self) -> tuple[Floats, str] | None:
        """Return the station's position (earth-centred) and where it stands; None when nowhere.

        raises IllPosedError: when the announced position changes: the station was set up anew within the
            recording.
        """
        if self.announced_m:
            all_m = np.stack(self.announced_m)
            spread = float(np.linalg.norm(all_m - all_m[0], axis=1).max())
            if spread > 1e-3:
                raise IllPosedError(
                    f"the station's position in RTCM 1005/1006 changes by {spread:.3f} m",
                    "give --base-position",
                    where=f"link {self.link}",
                )
            return all_m[0], "RTCM 1005/1006"
        return None if self.surveyed_m is None else (self.surveyed_m, "survey-in")

    def position_sigma_m(self) -> Floats | None:
        """Return the standard deviations of a position that a survey-in found; None of any other."""
        position = self.position_m()
        if position is None or self.surveyed_m is None or self.surveyed_sigma_m is None:
            return None
        # A survey-in is announced with rounded coordinates.
        same_mark_m = 0.01
        # An announced position is that of the survey-in, or was typed in.
        if np.linalg.norm(position[0] - self.surveyed_m) > same_mark_m:
            return None
        return np.full(3, self.surveyed_sigma_m / np.sqrt(3))


@lru_cache(maxsize=1)
def read_receivers(log: FlightLog) -> dict[str, ReceiverRecording]:
    """Read the raw frames of every receiver in a flight log; those of the same log are decoded once."""
    recordings: dict[str, ReceiverRecording] = {}
    _, logged = logged_exposures(log)
    for wire, messages in log.raw(*receiver_wires()):
        link = link_of(messages.channel)
        if link not in recordings:
            known = {source: marks for (of, source), marks in logged.items() if of == link}
            numbers = np.concatenate([np.empty(0, np.int64), *(marks.index for marks in known.values())])
            first = recordings[link] = ReceiverRecording(link, numbers, first_log_ns=int(messages.log_ns[0]))
            first.time_marks, first.mark_source = [*known.values()], next(iter(known), "")
        recordings[link].add(wire, messages)
    return recordings


def pick(receivers: dict[str, ReceiverRecording], link: str, role: str, log: FlightLog) -> ReceiverRecording:
    """Return the recording of a link."""
    if link in receivers:
        return receivers[link]
    names = ", ".join(sorted(receivers)) or "none"
    raise ConfigurationError(
        f"has no GNSS link {link!r} for the {role}; links with raw frames: {names}",
        f"name one with --{role}-link or give RINEX files",
        where=log,
    )


def refuse_unusable(recording: ReceiverRecording, role: str, log: FlightLog) -> None:
    """Refuse a recording that no position can be computed from."""
    if recording.epochs or recording.observation_frames:
        return
    ill_posed = IllPosedError.at(f"{log}, link {recording.link}")
    if recording.untimed_epochs:
        raise ill_posed(
            f"all {recording.untimed_epochs} RXM-RAWX epochs of the {role} have GPS week 0: the receiver "
            "never had the time",
            "record until the receiver has a fix",
        )
    if recording.empty_epochs:
        raise ill_posed(
            f"all {recording.empty_epochs} RXM-RAWX epochs of the {role} are empty",
            "check antenna and sky view",
        )
    raise ill_posed(
        f"the {role} has no raw observations (RXM-RAWX or RTCM MSM)",
        "let the receiver send RXM-RAWX and RXM-SFRBX",
    )
