"""The conversation with an autopilot: rates are asked for and verified, parameters read, clocks compared.

The conversation with a u-blox receiver: version, settings, acknowledgement, and whether they hold.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from drivers import ubx
from drivers.frames import Batch, Wire
from drivers.mavlink.decode import FRAGMENT_BYTES, FRAGMENTS, autopilots, decode, encode, fragments, sources
from drivers.mavlink.dialect import Dialect
from drivers.ubx import configure
from photocal.base.errors import DeviceError

_PATIENCE_S, _ATTEMPTS, _LOSSES = 1.0, 4, 2


# What is to be said now: frames for the device, notes for the person, and alarms.
DialogueStep = tuple[list[bytes], list[str], list[str]]


class ReceiverDialogue:
    """Configures a receiver and verifies what it has kept.

    rate_ms: time between measurements, milliseconds.
    """

    def __init__(self, port: str, messages: tuple[str, ...], rate_ms: int) -> None:
        self._wanted = port, messages, rate_ms
        self._steps: list[configure.Step] | None = None
        self._verifying = False
        self._attempts = 0
        self._losses = 0
        self._asked_s = 0.0
        # Whether the configuration holds or was given up.
        self.finished = False

    def step(self, batch: Batch | None, steady_s: float, clock_ns: int) -> DialogueStep:  # noqa: ARG002
        """Take what was received and return what is to be said now."""
        notes: list[str] = []
        alarms: list[str] = []
        frames: list[bytes] = []
        for frame in batch or ():
            if self.finished:
                break
            if frame.wire != Wire.UBX:
                continue
            try:
                self._take(frame.kind, frame.data[6:-2], notes)
            except DeviceError as refusal:
                self._give_up(str(refusal), alarms)
        if not self.finished and not (self._attempts and steady_s - self._asked_s < _PATIENCE_S):
            if self._attempts == _ATTEMPTS:
                self._give_up("the receiver does not answer; check cable, speed and port", alarms)
            else:
                self._attempts += 1
                self._asked_s = steady_s
                frames = [self._question()]
        return frames, notes, alarms

    def _question(self) -> bytes:
        if self._steps is None:
            return ubx.encode(configure.MON_VER, b"")
        return self._steps[0].poll if self._verifying else self._steps[0].frame

    def _take(self, kind: int, payload: bytes, notes: list[str]) -> None:
        if self._steps is None:
            if kind == configure.MON_VER and len(payload) >= 40:
                generation, software = configure.read_version(payload)
                self._steps = configure.steps(generation, *self._wanted)
                self._attempts = 0
                notes.append(f"is a u-blox receiver of generation {generation}, {software}")
            return
        current = self._steps[0]
        answer = configure.acknowledged(kind, payload)
        if answer is not None and answer[0] == current.kind and self._attempts and not self._verifying:
            if not answer[1]:
                raise DeviceError(f"the receiver refused the configuration of {current.what} (ACK-NAK)")
            self._verifying = True
            self._attempts = 0
        elif self._verifying and kind in (configure.CFG_VALGET, configure.CFG_MSG, configure.CFG_RATE):
            settings = configure.read_settings(kind, payload)
            if not settings.keys() >= dict(current.expected).keys():
                return
            if any(settings[key] != value for key, value in current.expected):
                # The acknowledgement may have been a late one of the request before: set it once more.
                self._losses += 1
                self._verifying, self._attempts = False, 0
                if self._losses < _LOSSES:
                    return
                raise DeviceError(
                    f"the receiver acknowledged the configuration of {current.what} but did not keep it"
                )
            self._steps.pop(0)
            self._losses = 0
            self._verifying = False
            self._attempts = 0
            if not self._steps:
                self.finished = True
                notes.append("is configured, verified")

    def _give_up(self, why: str, alarms: list[str]) -> None:
        self.finished = True
        alarms.append(f"is not configured: {why}")


# Not the 255 of a ground station: a failsafe that waits for the pilot's station must not take us for it. For
# the same reason no heartbeat is sent.
SYSTEM, COMPONENT = 245, 191
SET_MESSAGE_INTERVAL = 511
# Parameters are asked for one by one: a slow radio has room for each. Those it lacks are not answered.
_PARAMETER_EVERY_S, _PARAMETER_ROUNDS = 0.1, 2
_RESULTS = ("accepted", "temporarily rejected", "denied", "unsupported", "failed", "in progress", "cancelled")


class VehicleDialogue:
    """Asks an autopilot for message rates, parameters and its time, and gives it corrections.

    timesync_every_s: time between comparisons of the clocks; 0 for none: then those of the autopilot go
        unanswered, too.
    parameters: names of the parameters that are read once the rates are settled.
    """

    def __init__(
        self,
        dialect: Dialect,
        rates_hz: dict[str, float],
        timesync_every_s: float,
        parameters: Sequence[str] = (),
    ) -> None:
        self._dialect = dialect
        self._open = list(rates_hz.items())
        self._timesync_every_s = timesync_every_s
        self._timesync_due_s = 0.0
        self._unread: list[str] | None = list(parameters) * _PARAMETER_ROUNDS or None
        self._read: set[str] = set()
        self._parameter_due_s = 0.0
        self._target: tuple[int, int] | None = None
        self._attempts = 0
        self._asked_s = 0.0
        self._sequence = 0
        self._carried = 0
        self._too_long: set[int] = set()

    def step(self, batch: Batch | None, steady_s: float, clock_ns: int) -> DialogueStep:
        """Take what was received and return what is to be said now."""
        notes: list[str] = []
        alarms: list[str] = []
        if batch is not None and len(batch):
            if self._target is None:
                self._target = next(iter(autopilots(batch, self._dialect)), None)
                if self._target is not None:
                    notes.append(f"has an autopilot: system {self._target[0]}, component {self._target[1]}")
            self._take_answers(batch, notes, alarms)
        if self._target is None:
            return [], notes, alarms
        frames = [*self._answer_timesync(batch, clock_ns), *self._ask(steady_s, alarms)]
        frames += self._read_parameters(batch, steady_s, notes)
        if self._timesync_every_s and steady_s >= self._timesync_due_s:
            self._timesync_due_s = steady_s + self._timesync_every_s
            frames.append(self.frame("TIMESYNC", {"tc1": 0, "ts1": clock_ns}))
        return frames, notes, alarms

    def frame(self, name: str, values: Mapping[str, object]) -> bytes:
        """Return the frame of a message from us, numbered."""
        message = self._dialect.number(name)
        made = encode(
            self._dialect, message, values, sequence=self._sequence, system=SYSTEM, component=COMPONENT
        )
        self._sequence += 1
        return made

    def carry(self, kind: int, message: bytes) -> tuple[list[bytes], str]:
        """Return the frames that carry an RTCM message, and words, once for each kind, when none can."""
        pieces = fragments(message, self._carried)
        if pieces:
            self._carried += 1
            return [self.frame("GPS_RTCM_DATA", piece) for piece in pieces], ""
        mentioned = kind in self._too_long
        self._too_long.add(kind)
        limit = FRAGMENT_BYTES * FRAGMENTS
        words = f"does not get RTCM {kind}: {len(message)} bytes, at most {limit} can be sent"
        return [], "" if mentioned else words

    def _answer_timesync(self, batch: Batch | None, clock_ns: int) -> list[bytes]:
        """Tell an autopilot that asks the time of our clock; what it asks of others is theirs."""
        if batch is None or not self._timesync_every_s:
            return []
        asked = decode(batch, self._dialect.number("TIMESYNC"), self._dialect)
        system, _ = sources(batch, asked.index)
        to_us = (system == (self._target or (0, 0))[0]) & (asked.fields["tc1"] == 0)
        if "target_system" in (asked.fields.dtype.names or ()):
            to_us &= np.isin(asked.fields["target_system"], (0, SYSTEM))
        questions = asked.fields["ts1"][to_us].tolist()
        return [self.frame("TIMESYNC", {"tc1": clock_ns, "ts1": question}) for question in questions]

    def _ask(self, steady_s: float, alarms: list[str]) -> list[bytes]:
        if not self._open or (self._attempts and steady_s - self._asked_s < _PATIENCE_S):
            return []
        if self._attempts == _ATTEMPTS:
            self._refuse("no answer", alarms)
            if not self._open:
                return []
        name, rate = self._open[0]
        self._attempts += 1
        self._asked_s = steady_s
        system, component = self._target or (0, 0)
        values = {
            "target_system": system,
            "target_component": component,
            "command": SET_MESSAGE_INTERVAL,
            "param1": self._dialect.number(name),
            "param2": 1e6 / rate,
        }
        return [self.frame("COMMAND_LONG", values)]

    def _read_parameters(self, batch: Batch | None, steady_s: float, notes: list[str]) -> list[bytes]:
        """Ask for the next parameter that was not received yet."""
        if batch is not None:
            answers = decode(batch, self._dialect.number("PARAM_VALUE"), self._dialect)
            self._read |= {name.decode("latin-1") for name in answers.fields["param_id"].tolist()}
        if self._open or self._unread is None or steady_s < self._parameter_due_s:
            return []
        self._parameter_due_s = steady_s + _PARAMETER_EVERY_S
        self._unread = [name for name in self._unread if name not in self._read]
        if not self._unread:
            self._unread = None
            notes.append(f"reports {len(self._read)} parameters: acquire info shows those of its mounting")
            return []
        system, component = self._target or (0, 0)
        name = self._unread.pop(0)
        values = {"target_system": system, "target_component": component, "param_index": -1}
        return [self.frame("PARAM_REQUEST_READ", {**values, "param_id": name.encode()})]

    def _take_answers(self, batch: Batch, notes: list[str], alarms: list[str]) -> None:
        # MAV_RESULT_ACCEPTED.
        accepted = 0
        if self._target is None:
            return
        answers = decode(batch, self._dialect.number("COMMAND_ACK"), self._dialect)
        system, component = sources(batch, answers.index)
        fields = answers.fields[(system == self._target[0]) & (component == self._target[1])]
        for command, result in zip(fields["command"].tolist(), fields["result"].tolist(), strict=True):
            if command != SET_MESSAGE_INTERVAL or not self._open or not self._attempts:
                continue
            if result == accepted:
                name, rate = self._open.pop(0)
                self._attempts = 0
                notes.append(f"sends {name} at {rate:g} Hz")
            else:
                self._refuse(_RESULTS[result] if result < len(_RESULTS) else f"result {result}", alarms)

    def _refuse(self, why: str, alarms: list[str]) -> None:
        name, rate = self._open.pop(0)
        self._attempts = 0
        alarms.append(f"does not send {name} at {rate:g} Hz ({why})")
