"""The conversation with a u-blox receiver: version, settings, acknowledgement, and whether they hold."""

from dataclasses import dataclass

from drivers.frames import Batch, Wire
from drivers.ubx import configure, encode
from photocal.base.errors import DeviceError

_PATIENCE_S, _ATTEMPTS, _LOSSES = 1.0, 4, 2


@dataclass(frozen=True)
class DialogueStep:
    """Bytes for the device and words for the person (an error when it is an alarm)."""

    frames: tuple[bytes, ...] = ()
    notes: tuple[str, ...] = ()
    alarms: tuple[str, ...] = ()


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
        frames: tuple[bytes, ...] = ()
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
                frames = (self._question(),)
        return DialogueStep(frames, tuple(notes), tuple(alarms))

    def _question(self) -> bytes:
        if self._steps is None:
            return encode(configure.MON_VER, b"")
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
                    f"the receiver acknowledged the configuration of {current.what} and lost it"
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
