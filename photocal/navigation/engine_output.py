"""Position files of the engine: one row per epoch with covariance, ratio and velocity."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.arrays import Flags, Floats, Integers
from drivers.errors import IllPosedError, InputMalformedError
from photocal.navigation.time import WEEK_NS, GpsTime

FIXED, FLOAT, SINGLE = 1, 2, 5
_COLUMNS = 15
_LEAST_SIGMA_M = 1e-4


@dataclass(frozen=True)
class EngineSolution:
    """Positions of one run of the engine.

    time: epochs.
    lat_deg, lon_deg, height_m (n,): geodetic position, ellipsoidal height.
    quality (n,): 1 fixed, 2 float, 5 single, as the engine numbers them.
    satellites (n,): number used.
    covariance_m2 (n, 3, 3): east, north, up, as the engine claims it.
    age_s, ratio (n,): age of the base's observations; ratio test.
    velocity_m_s (n, 3): east, north, up; NaN where the engine gave none.
    """

    time: GpsTime
    lat_deg: Floats
    lon_deg: Floats
    height_m: Floats
    quality: Integers
    satellites: Integers
    covariance_m2: Floats
    age_s: Floats
    ratio: Floats
    velocity_m_s: Floats

    def __len__(self) -> int:
        return len(self.time)

    def rows(self, chosen: Integers | Flags) -> EngineSolution:
        """Return some of the epochs."""
        return EngineSolution(**{name: values[chosen] for name, values in vars(self).items()})

    @property
    def sigma_m(self) -> Floats:
        """Standard deviations (n, 3), east, north, up."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance_m2, axis1=1, axis2=2)))

    def at(self, time: GpsTime, tolerance_ns: int = 20_000_000) -> Integers:
        """Return the row for each instant, -1 where there is none."""
        place = np.clip(np.searchsorted(self.time.ns, time.ns), 1, max(len(self) - 1, 1))
        left = np.abs(self.time.ns[place - 1] - time.ns)
        right = np.abs(self.time.ns[np.minimum(place, len(self) - 1)] - time.ns)
        row = np.where(left <= right, place - 1, np.minimum(place, len(self) - 1))
        near = np.minimum(left, right) <= tolerance_ns
        return np.where(near, row, -1)

    def with_quality(self, quality: Integers, covariance_m2: Floats) -> EngineSolution:
        """Return the same positions with another judgement."""
        return replace(self, quality=quality, covariance_m2=covariance_m2)


def read_solution(path: Path) -> EngineSolution:
    """Read a position file (geodetic, time as week and seconds)."""
    lines = [line.split() for line in path.read_text("latin-1").splitlines() if line and line[0] != "%"]
    rows = [line for line in lines if len(line) >= _COLUMNS]
    if not rows:
        raise IllPosedError(
            "the engine found no position",
            where=path.stem,
            remedy="check that ephemerides and observations are of the same time",
        )
    velocity = np.full((len(rows), 3), np.nan)
    try:
        week = np.array([int(row[0]) for row in rows], np.int64)
        tow_ns = np.array([_exact_ns(row[1]) for row in rows], np.int64)
        table = np.array([[float(v) for v in row[2:_COLUMNS]] for row in rows])
        np.asarray_chkfinite(table[:, 5:11])
        for number, row in enumerate(rows):
            if len(row) >= _COLUMNS + 3:
                velocity[number] = [float(v) for v in row[_COLUMNS : _COLUMNS + 3]]
    except (ValueError, OverflowError) as cause:
        raise InputMalformedError(
            f"is no position file with times as week and seconds ({cause})",
            where=path,
            remedy="take one with GPS weeks and seconds (out-timeform = tow)",
        ) from cause
    quality = table[:, 3].astype(np.int64)
    sn, se, su, sne, seu, sun = table[:, 5:11].T
    # The engine prints four decimals: a sigma of zero is one below them.
    sn, se, su = (np.maximum(v, _LEAST_SIGMA_M) for v in (sn, se, su))
    covariance = np.empty((len(rows), 3, 3))
    covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 2, 2] = se**2, sn**2, su**2
    # The engine prints the root of a covariance, with the covariance's sign.
    for i, j, root in ((0, 1, sne), (0, 2, seu), (1, 2, sun)):
        covariance[:, i, j] = covariance[:, j, i] = np.sign(root) * root**2
    covariance = _possible(covariance, quality)
    return EngineSolution(
        GpsTime(week * WEEK_NS + tow_ns),
        table[:, 0],
        table[:, 1],
        table[:, 2],
        quality,
        table[:, 4].astype(np.int64),
        covariance,
        table[:, 11],
        table[:, 12],
        velocity[:, [1, 0, 2]],
    )


def _possible(covariance: Floats, quality: Integers) -> Floats:
    """Replace matrices that are no covariances by that of the nearest epoch of the same quality.

    The engine loses digits when it fixes ambiguities: variances below zero are printed as 0, with
    covariances beside them that no variances could have.
    """
    printed = np.diagonal(covariance, axis1=1, axis2=2).min(axis=1) > _LEAST_SIGMA_M**2
    sound = printed & (np.linalg.eigvalsh(covariance)[:, 0] > _LEAST_SIGMA_M**2 / 100)
    for value in np.unique(quality[~sound]):
        lost, good = (np.flatnonzero((quality == value) & which) for which in (~sound, sound))
        if not len(good):
            # Nothing says how the errors go together; the printed sigmas are all there is.
            covariance[lost] = covariance[lost] * np.eye(3)
            continue
        after = np.clip(np.searchsorted(good, lost), 1, max(len(good) - 1, 1))
        left, right = good[after - 1], good[np.minimum(after, len(good) - 1)]
        covariance[lost] = covariance[np.where(lost - left <= right - lost, left, right)]
    return covariance


def _exact_ns(text: str) -> int:
    whole, _, part = text.partition(".")
    return int(whole) * 1_000_000_000 + int(part.ljust(9, "0")[:9])
