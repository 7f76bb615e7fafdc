"""Records of an autopilot's own log: what both kinds of self-describing logs have in common."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frames import Batch, Framer, Wire, batch_of
from photocal.base.arrays import Flags, Floats, Integers

# What an examination answers besides a length.
NOTHING, WAIT = 0, -1
_YEAR_NS = 366 * 86_400 * 10**9


@dataclass(frozen=True)
class Records:
    """Records of one kind.

    index (n,): position of each in the batch.
    columns: their members in the units of the log.
    """

    index: Integers
    columns: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.index)

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def number(self, *names: str) -> Floats:
        """Return the first of several members that is there; NaN when none is."""
        for name in names:
            if name in self.columns and self.columns[name].dtype.kind in "iufb":
                # A damaged number may be a signalling NaN: it stays a NaN, without a word.
                with np.errstate(invalid="ignore"):
                    return self.columns[name].astype(float)
        return np.full(len(self.index), np.nan)

    def rows(self, kept: Flags) -> "Records":
        """Return some of the records."""
        return Records(self.index[kept], {name: column[kept] for name, column in self.columns.items()})


def since_boot_ns(values: NDArray[Any], unit_ns: int) -> Integers:
    """Return nanoseconds; what no running time of an autopilot can be (over a year) becomes -1."""
    sure = values.astype(np.uint64) < _YEAR_NS // unit_ns
    return np.where(sure, np.where(sure, values, 0).astype(np.int64) * unit_ns, -1)


def placed(boot_ns: Integers, stamps: list[tuple[Integers, Integers]]) -> tuple[Integers, Integers]:
    """Return time since the start and UTC of records (their places and UTC, by kinds) that have both."""
    index, utc = (np.concatenate(column) for column in zip(*stamps, strict=True))
    known = boot_ns[index] >= 0
    return boot_ns[index[known]], utc[known]


def batch_of_rows(
    wire: Wire, data: bytes, base: int, rows: list[tuple[int, int, int]], damage: list[tuple[int, int]]
) -> Batch:
    """Return start, length and kind of records as a batch; damage is measured from the start of `data`."""
    table = np.array(rows, np.int64).reshape(-1, 3)
    lost = np.array(damage, np.int64).reshape(-1, 2)
    lost[:, 0] += base
    return batch_of(wire, data, base, (table[:, 0], table[:, 1], table[:, 2]), lost)


class RecordFramer(Framer):
    """Finds the records of a log.

    A record is taken where its head can be meant and another one, or the end, follows. One that is followed
    by damage is taken unless a record that is followed properly begins inside it: then bytes are missing in
    it. After damage only records that are followed properly are taken.
    """

    wire: Wire

    def __init__(self) -> None:
        super().__init__()
        # Whether the byte before the pending ones belongs to no record.
        self._after_damage = False

    def _begun(self) -> bool:
        return self._examine(self._pending, 0) == WAIT

    @abstractmethod
    def _examine(self, data: bytes, at: int) -> int:
        """Return the length of the record that begins at a place, `NOTHING` or `WAIT`."""

    @abstractmethod
    def _next(self, data: bytes, at: int) -> int:
        """Return the next place from `at` on where a record may begin; the end of the data if none."""

    @abstractmethod
    def _learn(self, data: bytes, at: int) -> int:
        """Take note of a record that was taken; return its kind."""

    def _take(self, closed: bool) -> Batch:
        data, end = self._pending, len(self._pending)
        rows: list[tuple[int, int, int]] = []
        damage: list[tuple[int, int]] = []
        at = clean = 0
        while at < end:
            length = self._believed(data, at, closed, sure=self._after_damage)
            if length == WAIT:
                break
            if length == NOTHING:
                self._after_damage = True
                at = self._next(data, at + 1)
                continue
            self._after_damage = False
            if at > clean:
                damage.append((clean, at - clean))
            rows.append((at, length, self._learn(data, at)))
            at += length
            clean = at
        if at > clean:
            damage.append((clean, at - clean))
        return batch_of_rows(self.wire, *self._consumed(at), rows, damage)

    def _believed(self, data: bytes, at: int, closed: bool, *, sure: bool) -> int:
        length = self._closed_examine(data, at, closed)
        if length <= 0:
            return length
        follows = self._follows(data, at + length, closed)
        if follows == WAIT:
            return WAIT
        if follows:
            return length
        if sure:
            return NOTHING
        inside = self._next(data, at + 1)
        while inside < at + length:
            inner = self._closed_examine(data, inside, closed)
            followed = self._follows(data, inside + inner, closed) if inner > 0 else inner
            if followed == WAIT:
                return WAIT
            if followed:
                return NOTHING
            inside = self._next(data, inside + 1)
        return length

    def _closed_examine(self, data: bytes, at: int, closed: bool) -> int:
        length = self._examine(data, at)
        return NOTHING if closed and length == WAIT else length

    def _follows(self, data: bytes, at: int, closed: bool) -> int:
        """Return 1 where a record or the end follows, `NOTHING` or `WAIT`."""
        if at == len(data):
            return 1 if closed else WAIT
        length = self._head(data, at)
        return NOTHING if closed and length == WAIT else length

    def _head(self, data: bytes, at: int) -> int:
        """Return 1 where the head of a record begins, `NOTHING` or `WAIT`."""
        return min(self._examine(data, at), 1)
