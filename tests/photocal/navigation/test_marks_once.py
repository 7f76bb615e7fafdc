"""A pulse is decoded once: what was logged of it is taken, raw frames only where nothing was."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquire.log.reader import LogReader
from acquire.log.writer import LogWriter
from drivers import ubx
from drivers.receiver import TimeMarks
from drivers.ubx.decode import RXM_RAWX, TIM_TM2, layout, signal_layout
from drivers.ubx.protocol import UbxProtocol
from photocal.base.codec import same
from photocal.base.errors import InputMalformedError
from photocal.navigation.events import FALLING, RISING, Events, time_marks
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.receiver_recording import ReceiverRecording, read_receivers
from photocal.navigation.time import GpsTime
from tests.photocal.navigation.conftest import ImportLog

WEEK, LEAP_S = 2022, 18  # October 2018; 18 s by IERS Bulletin C 52
UTC, GNSS, OWN = 2 << 3, 1 << 3, 0
BOTH, VALID = 0x84, 0x40
Change = Callable[[int, dict[str, Any]], dict[str, Any] | None]


def epoch(seconds: float) -> bytes:
    head, signal = np.zeros(1, layout(RXM_RAWX)), np.zeros(1, signal_layout())
    head["rcvTow"], head["week"], head["leapS"] = seconds, WEEK, LEAP_S
    head["numMeas"] = head["recStat"] = 1
    signal["prMes"] = 2e7
    return ubx.encode(RXM_RAWX, head.tobytes() + signal.tobytes())


def pulse(count: int, seconds: float, base: int = UTC, flags: int = BOTH | VALID) -> bytes:
    row = np.zeros(1, layout(TIM_TM2))
    row["flags"], row["count"], row["wnR"], row["wnF"] = flags | base, count, WEEK, WEEK
    row["towMsR"], row["towSubMsR"] = int(seconds * 1000), 123_456
    row["towMsF"], row["accEst"] = int(seconds * 1000) + 3, 25
    return ubx.encode(TIM_TM2, row.tobytes())


STREAM = b"".join(
    part
    for k in range(1, 20)
    for part in (epoch(100 + k), pulse(k, 100.4 + k, UTC if k % 2 else GNSS, 0x84 | (k > 2) * VALID))
)


def changed(log: Path, name: str, change: Change) -> Path:
    """The log with other messages of exposures; None leaves one out."""
    made = log.with_name(name)
    with made.open("wb") as stream:
        writer = LogWriter(stream)
        for chunk in LogReader(log).chunks():
            for part in chunk:
                payloads, kept = list(part.payloads), list(range(len(part.payloads)))
                if part.channel.topic == "/camera/exposure":
                    rows = [change(k, json.loads(payload)) for k, payload in enumerate(payloads)]
                    kept = [k for k, row in enumerate(rows) if row is not None]
                    payloads = [json.dumps(rows[k]).encode() for k in kept]
                columns = (part.log_ns[kept], part.publish_ns[kept], part.sequence[kept])
                writer.messages(part.channel, payloads, *columns)
        writer.close()
    return made


def older(_: int, row: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in row.items() if key not in ("time_base", "gps_time")}


@pytest.fixture(scope="module")
def log(import_log: ImportLog) -> Path:
    return import_log("pulses", {"rover": STREAM, "base": b"".join(epoch(100 + k) for k in range(20))})


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Counts of the edges that the driver decodes."""
    counts: list[int] = []
    plain = UbxProtocol.time_marks

    def counted(self: UbxProtocol, batch: Any) -> Any:
        marks = plain(self, batch)
        counts.extend(count for each in marks.values() for count in each.count.tolist())
        return marks

    monkeypatch.setattr(UbxProtocol, "time_marks", counted)
    return counts


def rover(*logs: Path) -> ReceiverRecording:
    return read_receivers(FlightLog(logs))["rover"]


def events(recording: ReceiverRecording, edge: str = RISING) -> Events:
    before = recording.epochs_before_marks()
    return time_marks(recording.marks(), edge, "rover", before, recording.mark_source)


def test_what_was_decoded_at_logging_is_not_decoded_again(log: Path, decoded: list[int]) -> None:
    rising, falling = events(rover(log)), events(rover(log), FALLING)
    assert decoded == []
    assert (rising.source, len(rising), len(falling)) == ("TIM-TM2 rising of rover", 17, 17)
    # Half of the receiver's times are UTC, without the leap seconds that GPS time has counted.
    leap = np.where(np.arange(3, 20) % 2, LEAP_S, 0)
    told = [WEEK * 604_800 * 10**9 + (100_400 + 1000 * k) * 10**6 + 123_456 for k in range(3, 20)]
    assert rising.time.ns.tolist() == sorted((np.array(told) + leap * 10**9).tolist())
    assert rising.accuracy_s == pytest.approx(25e-9)
    assert "time base GNSS and UTC" in rising.remarks
    assert "2 rising edges without a valid time left out" in rising.remarks
    # The last epoch before each pulse in the stream.
    assert rising.stream_ns is not None
    of_gps = rising.number % 2 == 0
    assert (rising.stream_ns == GpsTime.from_week(np.full(17, WEEK), 100.0 + rising.number).ns).all()
    assert ((rising.time.ns - rising.stream_ns)[of_gps] == 400_123_456).all()


def test_older_logs_and_lost_messages_give_the_same(log: Path, decoded: list[int]) -> None:
    new, old = events(rover(log)), events(rover(changed(log, "old.mcap", older)))
    assert sorted(decoded) == sorted([*range(1, 20)] * 2)
    assert same(new, old)
    decoded.clear()
    # As `acquire recover` leaves it: frames of the last chunk without what was decoded of them.
    lost = changed(log, "lost.mcap", lambda k, row: None if k >= 30 else row)
    assert same(events(rover(lost)), new)
    assert sorted(set(decoded)) == list(range(16, 20))


def test_logs_that_follow_each_other_count_on(log: Path, import_log: ImportLog, decoded: list[int]) -> None:
    later = import_log("later", {"rover": b"".join(epoch(500 + k) + pulse(k, 500.2 + k) for k in range(3))})
    decoded.clear()
    both = events(rover(log, changed(later, "later-old.mcap", older)))
    assert len(both) == 17 + 3
    assert sorted(decoded) == [0, 0, 1, 1, 2, 2]
    assert both.stream_ns is not None
    assert both.stream_ns[-3:].tolist() == GpsTime.from_week([WEEK] * 3, [500.0, 501.0, 502.0]).ns.tolist()


def test_the_receivers_own_time_is_refused_from_the_log(import_log: ImportLog, decoded: list[int]) -> None:
    log = import_log("own", {"rover": epoch(1) + pulse(1, 2.0, OWN) + epoch(3)})
    decoded.clear()
    with pytest.raises(InputMalformedError, match="own time base"):
        events(rover(log))
    assert decoded == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"time_base": "lunar"},
        {"time_base": 3},
        {"gps_time": None},
        {"gps_time": {"sec": 1}},
        {"sequence": "a"},
    ],
)
def test_damaged_messages_are_refused(log: Path, wrong: dict[str, Any]) -> None:
    broken = changed(log, "broken.mcap", lambda k, row: row | wrong if k == 20 else row)
    with pytest.raises(InputMalformedError, match="cannot be read"):
        rover(broken)


@pytest.mark.shared
def test_a_recorded_flight_gives_the_same_both_ways(shared: Path, import_log: ImportLog) -> None:
    source = shared / "data/gnss-ubx-m8p-base-rover/rover-20181004-1237.ubx.gz"
    log = import_log("recorded", {"rover": source})
    new, old = rover(log), rover(changed(log, "recorded-old.mcap", older))
    assert isinstance(new.marks(), TimeMarks)
    assert len(new.marks().index) == 7
    assert same(new.marks(), old.marks())
    assert new.epochs_before_marks().tolist() == old.epochs_before_marks().tolist()
