"""MAVLink frames on the wire: the test whether an intact one stands at a place.

A frame of a message in the tables is intact when its checksum with the message's seed agrees. A frame that
the tables do not know (another dialect, a private message, another definition of a known number) cannot be
tested so: its seed is unknown. It is accepted as unknown when

- a seed exists that explains its checksum (one in 256 frames of noise has one),
- it ends where a frame may end: at the start of another one or at the end of the stream, or an earlier frame
  of the same number had the same seed, and
- no intact frame of a known message begins inside it. So an accepted unknown never costs a known one.

Once a number has shown the same seed twice, frames of that number with a seed never seen are refused.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Callable
from re import compile as pattern

from drivers.checksums import REVERSED
from drivers.mavlink.dialect import Dialect
from drivers.window import NOTHING, Examination, Window, need

V1, V2 = 0xFE, 0xFD
SIGNED = 0x01
SIGNATURE_BYTES = 13
STARTS = pattern(rb"[\xfe\xfd]")

_STEP = [crc_hqx(bytes((value,)), 0) for value in range(256)]


def extent(data: bytes, at: int) -> Examination:
    """Return the length and the message id that the header at `at` claims, and True when it could be read.

    Length 0: no header can begin like this; negative: so many bytes are needed to tell.
    """
    room = len(data) - at
    if data[at] == V1:
        return (data[at + 1] + 8, data[at + 5], True) if room >= 6 else (-6, 0, False)
    if room < 3:
        return (-3, 0, False)
    flags = data[at + 2]
    if flags & ~SIGNED:
        # The standard: a receiver must discard what has incompatibility flags that it does not know.
        return NOTHING
    if room < 10:
        return (-10, 0, False)
    length = data[at + 1] + 12 + (SIGNATURE_BYTES if flags & SIGNED else 0)
    return (length, int.from_bytes(data[at + 7 : at + 10], "little"), True)


class MavlinkGrammar:
    """Examines places of a stream for MAVLink frames; remembers the seeds of unknown messages.

    Parameters
    ----------
    dialect : Dialect
        The known messages.
    """

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self._seen: dict[int, dict[int, int]] = {}

    def examine_known(self, window: Window, at: int) -> Examination:
        """Examine one place for a frame of a known message."""
        length, kind, readable = extent(window.data, at)
        if not readable:
            return need(window, -length) if length else NOTHING
        seed = self._dialect.seeds.get(kind)
        if seed is None:
            return NOTHING
        if at + length > len(window.data):
            return need(window, length)
        remainder, check = self._remainder(window, at, length)
        agrees = _continued(remainder, seed) == check
        return (length, kind, True) if agrees else NOTHING

    def examine(self, window: Window, at: int, ends: Callable[[int], bool | None]) -> Examination:
        """Examine one place for a frame of any message."""
        found = self.examine_known(window, at)
        if found[0]:
            return found
        length, kind, readable = extent(window.data, at)
        if not readable:
            return NOTHING
        if not self._may_be_unknown(window.data, at, kind):
            return NOTHING
        if at + length > len(window.data):
            return need(window, length)
        seed = self.seed(window, at, length)
        if seed is None or not self._credible(kind, seed):
            return NOTHING
        if not self._seen.get(kind, {}).get(seed):
            boundary = ends(at + length)
            if boundary is None:
                return need(window, length + 1)
            if not boundary:
                return NOTHING
        inside = self._known_inside(window, at, at + length)
        if inside[0]:
            return inside if inside[0] < 0 else NOTHING
        self.remember(kind, seed)
        return (length, kind, False)

    def seed(self, window: Window, at: int, length: int) -> int | None:
        """Return the seed that explains the checksum of a frame, None when there is none."""
        remainder, check = self._remainder(window, at, length)
        # One step of the CRC maps the last byte x to ((r << 8) ^ table[(r >> 8) ^ x]).
        try:
            turned = _STEP.index(check ^ ((remainder << 8) & 0xFFFF)) ^ (remainder >> 8)
        except ValueError:
            return None
        return REVERSED[turned]

    def remember(self, kind: int, seed: int) -> None:
        """Note the seed of an accepted unknown frame."""
        seen = self._seen.setdefault(kind, {})
        seen[seed] = seen.get(seed, 0) + 1

    def _credible(self, kind: int, seed: int) -> bool:
        seen = self._seen.get(kind, {})
        return seed in seen or all(count < 2 for count in seen.values())

    def _may_be_unknown(self, data: bytes, at: int, kind: int) -> bool:
        if kind not in self._dialect.seeds:
            return True
        payload = data[at + 1]
        if data[at] == V1:
            return not self._dialect.possible_in_v1(kind, payload)
        return payload > self._dialect.layout(kind).itemsize

    def _known_inside(self, window: Window, begin: int, end: int) -> Examination:
        at = begin + 1
        while (match := STARTS.search(window.data, at, end)) is not None:
            found = self.examine_known(window, match.start())
            if found[0] > 0:
                return found
            if found[0] < 0:
                return (found[0] - (match.start() - begin), 0, False)
            at = match.start() + 1
        return NOTHING

    @staticmethod
    def _remainder(window: Window, at: int, length: int) -> tuple[int, int]:
        """Return checksum without seed and the checksum on the wire, both with their bits reversed."""
        turned = window.turned
        signed = window.data[at] == V2 and window.data[at + 2] & SIGNED
        end = at + length - 2 - (SIGNATURE_BYTES if signed else 0)
        return crc_hqx(turned[at + 1 : end], 0xFFFF), turned[end] << 8 | turned[end + 1]


def _continued(remainder: int, seed: int) -> int:
    return ((remainder << 8) & 0xFFFF) ^ _STEP[(remainder >> 8) ^ REVERSED[seed]]
