"""Records of an autopilot's own log: what both kinds of self-describing logs have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Flags, Floats, Integers
from drivers.frames import Batch, Wire


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

    def rows(self, kept: Flags) -> Records:
        """Return some of the records."""
        return Records(self.index[kept], {name: column[kept] for name, column in self.columns.items()})


class Definitions(Protocol):
    """What a self-describing log says of its own records; fills while it is read from its beginning."""

    def learn(self, batch: Batch) -> None:
        """Take over the definitions in a batch."""
        ...

    def decode(self, batch: Batch, name: str) -> Records:
        """Return the records of a kind, by name; none when the log does not define it."""
        ...

    def boot_ns(self, batch: Batch) -> Integers:
        """Return the time of each record since the autopilot started, nanoseconds; -1 where it has none."""
        ...

    def told_utc(self, batch: Batch) -> tuple[Integers, Integers]:
        """Return times since the start and UTC (nanoseconds) where a GNSS receiver told UTC."""
        ...


def batch_of_rows(
    wire: Wire,
    data: bytes,
    base: int,
    rows: list[tuple[int, int, int]],
    damage: list[tuple[int, int]],
) -> Batch:
    """Return start, length and kind of records as a batch; damage counts from the beginning of `data`."""
    table = np.array(rows, np.int64).reshape(-1, 3)
    lost = np.array(damage, np.int64).reshape(-1, 2)
    lost[:, 0] += base
    return Batch(
        data=data,
        base=base,
        start=table[:, 0],
        length=table[:, 1],
        wire=np.full(len(table), wire, np.uint8),
        kind=table[:, 2],
        known=np.ones(len(table), bool),
        damage=lost,
    )
