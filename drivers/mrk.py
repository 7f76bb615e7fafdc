"""Event lists of multirotors with RTK receivers: lines of the `Timestamp.MRK` file.

Columns (DJI, Matrice 4 Series User Manual 2025, p. 92): number, seconds of week, [week], offset north, east
and down from the antenna to the sensor in mm, latitude, longitude, ellipsoidal height, their sigmas, flag.
"""

import re

import numpy as np

from drivers.frames import Batch, Framer, Wire
from drivers.logged import Records, batch_of_rows
from photocal.base.arrays import Integers
from photocal.base.time_scales import week_to_ns

_NUMBER = r"\s*([+-]?\d{1,15}(?:\.\d{1,15})?)\s*"
_ROW = re.compile(
    rf"{_NUMBER}\s{_NUMBER}\s\[{_NUMBER}\]\s{_NUMBER},N\s{_NUMBER},E\s{_NUMBER},V\s{_NUMBER},Lat\s"
    rf"{_NUMBER},Lon\s{_NUMBER},Ellh\s{_NUMBER},{_NUMBER},{_NUMBER}\s{_NUMBER},Q\s*\Z"
)
COLUMNS = (
    "number", "seconds_of_week_s", "week", "north_mm", "east_mm", "down_mm", "latitude_deg", "longitude_deg",
    "height_m", "sigma_north_m", "sigma_east_m", "sigma_up_m", "flag",
)  # fmt: skip
EVENT_KIND = 1


def parse_event(line: str) -> tuple[float, ...] | None:
    """Return the values of a line in the order of `COLUMNS`; None when it is no event."""
    match = _ROW.match(line)
    return None if match is None else tuple(float(value) for value in match.groups())


class MrkFramer(Framer):
    """Lines of an event list that are events, the last one also without its end."""

    def _begun(self) -> bool:
        return False

    def _take(self, closed: bool) -> Batch:
        # Longer ones are no lines of a camera event list.
        longest_line = 1024
        data = self._pending
        rows: list[tuple[int, int, int]] = []
        damage: list[tuple[int, int]] = []
        at = 0
        while at < len(data):
            line_end = data.find(b"\n", at, at + longest_line)
            if line_end < 0 and len(data) - at < longest_line and not closed:
                break
            # What is longer than any event is not text: it is passed over piece by piece.
            end = line_end + 1 if line_end >= 0 else min(len(data), at + longest_line)
            if parse_event(data[at:end].decode("latin-1")) is not None:
                rows.append((at, end - at, EVENT_KIND))
            else:
                damage.append((at, end - at))
            at = end
        return batch_of_rows(Wire.MRK, *self._consumed(at), rows, damage)


def decode(batch: Batch) -> Records:
    """Return the events of a batch with the columns of `COLUMNS`."""
    index = batch.where(Wire.MRK, EVENT_KIND)
    lines = [batch.frame(i).data.decode("latin-1") for i in index.tolist()]
    table = np.array([parse_event(line) for line in lines], float).reshape(-1, len(COLUMNS))
    return Records(index, dict(zip(COLUMNS, table.T, strict=True)))


def event_gps_ns(events: Records) -> Integers:
    """Return GPS time of events, nanoseconds since its epoch; -1 where week or seconds are not valid."""
    week, seconds = events["week"], events["seconds_of_week_s"]
    sure = (week > 0) & (week < 1 << 16) & (seconds >= 0) & (seconds < 604_800)
    return np.where(sure, week_to_ns(np.where(sure, week, 0), np.where(sure, seconds, 0.0)), -1)
