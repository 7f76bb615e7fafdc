"""A piece of a stream under examination: running sums for its checksums and what an examination gives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.checksums import REVERSED

# What the examination of a place gives: (length, kind, known). Length 0: no frame begins there; negative: its
# absolute value is the number of bytes from that place on that are needed to decide.
Examination = tuple[int, int, bool]
NOTHING: Examination = (0, 0, False)


class Window:
    """A piece of a stream under examination, with running sums that make every checksum a subtraction.

    Parameters
    ----------
    data : bytes
        The bytes.
    closed : bool
        Whether the stream ends with them.
    """

    __slots__ = ("_first", "_second", "_turned", "_xor", "closed", "data")

    def __init__(self, data: bytes, closed: bool) -> None:
        self.data = data
        self.closed = closed
        self._turned: bytes | None = None
        self._first: NDArray[np.uint32] | None = None
        self._second: NDArray[np.uint32] | None = None
        self._xor: NDArray[np.uint8] | None = None

    @property
    def turned(self) -> bytes:
        """The bytes with the bits of each reversed, see `REVERSED`."""
        if self._turned is None:
            self._turned = self.data.translate(REVERSED)
        return self._turned

    def fletcher8(self, begin: int, end: int) -> tuple[int, int]:
        """Return the two Fletcher sums of ``data[begin:end]``."""
        if self._first is None or self._second is None:
            # Both sums are wanted modulo 256, so the wrap of 32 bits does no harm.
            values = np.frombuffer(self.data, np.uint8)
            self._first = np.zeros(len(values) + 1, np.uint32)
            np.cumsum(values, out=self._first[1:], dtype=np.uint32)
            self._second = np.zeros(len(values) + 2, np.uint32)
            np.cumsum(self._first, out=self._second[1:], dtype=np.uint32)
        before = int(self._first[begin])
        first = int(self._first[end]) - before
        second = int(self._second[end + 1]) - int(self._second[begin + 1]) - (end - begin) * before
        return first & 0xFF, second & 0xFF

    def xor8(self, begin: int, end: int) -> int:
        """Return the exclusive or of the bytes ``data[begin:end]``."""
        if self._xor is None:
            self._xor = np.zeros(len(self.data) + 1, np.uint8)
            np.bitwise_xor.accumulate(np.frombuffer(self.data, np.uint8), out=self._xor[1:])
        return int(self._xor[end] ^ self._xor[begin])


def need(window: Window, length: int) -> Examination:
    """Ask for more bytes, or find nothing when none will come."""
    return NOTHING if window.closed else (-length, 0, False)
