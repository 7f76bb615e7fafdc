"""Event lists and tables of positions, judged before they are used: faults are named by their lines."""

import datetime as dt
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.mrk import COLUMNS, parse_event
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import InputMalformedError
from photocal.base.geodesy import enu_offsets
from photocal.base.time_scales import WEEK_S
from photocal.findings.finding import Finding

# No aircraft that carries a camera for survey flies faster over ground, m/s.
FASTEST_M_S = 80.0
# Beside what it flies, a position may be off by so many of its sigmas, or by this amount without any, m.
SIGMAS, UNSTATED_M = 5.0, 20.0
# Lines that are closer in time are the same exposure, s.
SAME_S = 1e-3
# Positions of pictures whose receivers state no sigma, m: of code, and a second old at 15 m/s. Those that
# state one are of the exposure; the camera hangs beside the antenna.
PICTURE_SIGMA_M, PICTURE_LATE_M, PICTURE_OFFSET_M = 3.0, 15.0, 1.0


@dataclass(frozen=True)
class ListedPositions:
    """Positions of a list in the order of its lines.

    lines: what names each line: "line 7", or the name of a picture.
    time_s (n,): of the events by one clock; NaN where the list tells none.
    place (n, 3): latitude, longitude (deg), height (m).
    sigma_m (n, 3): east, north, up; NaN where not stated.
    number (n,): the device's own count; -1 where it tells none.
    """

    lines: tuple[str, ...]
    time_s: Floats
    place: Floats
    sigma_m: Floats
    number: Integers


def read_event_lines(lines: Sequence[str], where: object) -> tuple[Floats, tuple[str, ...]]:
    """Read the events of a list: columns as of `drivers.mrk` (n, 13), and what names the line of each.

    raises InputMalformedError: for a line that is no event; a list that was changed is not believed.
    """
    rows = list[tuple[float, ...]]()
    names = list[str]()
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        values = parse_event(line)
        if values is None:
            raise InputMalformedError(
                "is not an event (number, time, week, offsets N E V, Lat, Lon, Ellh, sigmas, Q)",
                "give the unchanged file of the vehicle",
                where=f"{where}, line {number}",
            )
        rows.append(values)
        names.append(f"line {number}")
    return np.array(rows).reshape(-1, len(COLUMNS)), tuple(names)


def listed_events(events: Floats, lines: Sequence[str]) -> ListedPositions:
    """Take the positions out of an event list.

    events (n, 13): columns as of `drivers.mrk`.
    """
    column = dict(zip(COLUMNS, events.T, strict=True))
    place = [column[key] for key in ("latitude_deg", "longitude_deg", "height_m")]
    sigma = [column[key] for key in ("sigma_east_m", "sigma_north_m", "sigma_up_m")]
    seconds = column["week"] * WEEK_S + column["seconds_of_week_s"]
    number = column["number"].astype(np.int64)
    return ListedPositions(tuple(lines), seconds, np.array(place).T, np.array(sigma).T, number)


def read_solution_events(lines: Sequence[str], where: object) -> ListedPositions:
    """Read the events of a solution of RTKLIB: time, latitude, longitude (deg), height (m), quality, sigmas.

    Source: RTKLIB 2.4.2 Manual, appendix B.1.

    raises InputMalformedError: for other coordinates, and for a line that is no position.
    """
    rows, names = list[tuple[float, ...]](), list[str]()
    for number, line in enumerate(lines, 1):
        if line.startswith("%"):
            if re.search(r"x-ecef|e-baseline|latitude\(d'", line):
                raise InputMalformedError(
                    "has other coordinates than latitude and longitude in degrees",
                    "write the solution with Lat/Lon/Height in decimal degrees",
                    where=f"{where}, line {number}",
                )
        elif line.strip():
            rows.append(_solution_row(line, f"{where}, line {number}"))
            names.append(f"line {number}")
    time_s, latitude, longitude, height, north, east, up = np.array(rows).reshape(-1, 7).T
    place, sigma = np.column_stack([latitude, longitude, height]), np.column_stack([east, north, up])
    return ListedPositions(tuple(names), time_s, place, sigma, np.full(len(names), -1))


def _solution_row(line: str, where: str) -> tuple[float, ...]:
    """Time (s), latitude, longitude, height, and the sigmas north, east, up of a line of a solution."""
    wrong = InputMalformedError(
        "is not a position (time, latitude, longitude, height, Q, ns, sigmas)",
        "give the unchanged file of RTKLIB",
        where=where,
    )
    cells = re.split(r"[,;\s]+", line.strip())
    try:
        if "/" in cells[0]:
            day = cells[0].replace("/", "-")
            time_s = dt.datetime.fromisoformat(f"{day}T{cells[1]}+00:00").timestamp()
        else:
            time_s = float(cells[0]) * WEEK_S + float(cells[1])
        latitude, longitude, height, _, _, *sigmas = (float(cell) for cell in cells[2:10])
    except (ValueError, IndexError) as refusal:
        raise wrong from refusal
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 360.0 and np.isfinite([time_s, height]).all()):
        raise wrong
    # Four decimals are printed: zero is a sigma that is not stated.
    told = [sigma if sigma > 0.0 else np.nan for sigma in sigmas]
    return time_s, latitude, longitude, height, *told, *[np.nan] * (3 - len(told))


@dataclass(frozen=True)
class JudgedPositions:
    """What of a list may be used.

    kept (n,): lines that are events of their own; others repeat one.
    placed (n,): whether the position may be used; sigma_known (n,): whether its sigmas may.
    """

    kept: Flags
    placed: Flags
    sigma_known: Flags
    findings: tuple[Finding, ...]


def judge_listed(listed: ListedPositions) -> JudgedPositions:
    """Judge a list by itself: zeros, sigmas of zero, duplicates, order, and jumps that no aircraft flies."""
    lat, lon, _ = listed.place.T
    finite = np.isfinite(listed.place).all(axis=1)
    credible = finite & (np.abs(lat) <= 90) & (np.abs(lon) <= 180) & ~((lat == 0) & (lon == 0))
    told = np.isfinite(listed.sigma_m).all(axis=1)
    positive = np.asarray(told & (listed.sigma_m > 0).all(axis=1))
    kept = _firsts(listed)
    together = _belonging(listed, credible & kept)
    findings = [
        *_named("events-without-position", ~credible, listed.lines),
        *_named("events-without-sigma", told & ~positive & credible, listed.lines),
        *_named("events-twice", ~kept, listed.lines),
        *_named("events-out-of-order", _backwards(listed.time_s), listed.lines),
        *_jumps(listed, credible & kept & ~together),
    ]
    return JudgedPositions(kept, credible & (together | ~kept), positive, tuple(findings))


def _offsets(place: Floats, origin: Floats) -> Floats:
    """East, north, up of latitudes, longitudes (deg) and heights, (n, 3)."""
    latitude, longitude, height = place.T
    return enu_offsets(latitude, longitude, height, origin)


def _named(code: str, rows: Flags, lines: Sequence[str], **more: float) -> Iterator[Finding]:
    if rows.any():
        named = tuple(lines[k] for k in np.flatnonzero(rows).tolist())
        figures = {"n": float(rows.sum()), "all": float(len(rows)), "lines": named, **more}
        yield Finding(code, "doubtful", figures=figures)


def _firsts(listed: ListedPositions) -> Flags:
    """Which lines are no repetition of an earlier one, by time or by number and place."""
    keys = [
        round(time / SAME_S) if np.isfinite(time) else (number, *place)
        for time, number, place in zip(listed.time_s, listed.number, listed.place.tolist(), strict=True)
    ]
    seen = dict[object, int]()
    return np.array([seen.setdefault(key, k) == k for k, key in enumerate(keys)], dtype=np.bool_)


def _backwards(time_s: Floats) -> Flags:
    """Lines that are earlier than one before them."""
    latest = np.fmax.accumulate(np.where(np.isfinite(time_s), time_s, -np.inf))
    before = np.concatenate([[-np.inf], latest[:-1]])
    return np.asarray(time_s < before - SAME_S)


def _belonging(listed: ListedPositions, usable: Flags) -> Flags:
    """The most lines that one aircraft can have flown, each from the one before; all without times."""
    rows = np.flatnonzero(usable & np.isfinite(listed.time_s))
    if len(rows) < 2:
        return usable.copy()
    rows = rows[np.argsort(listed.time_s[rows], kind="stable")]
    place, time = listed.place[rows], listed.time_s[rows]
    offset = _offsets(place, np.median(place, axis=0))
    sigma = np.linalg.norm(np.where(listed.sigma_m[rows] > 0, listed.sigma_m[rows], np.nan), axis=1)
    room = np.where(np.isfinite(sigma), SIGMAS * sigma, UNSTATED_M)
    count, came_from = np.ones(len(rows), dtype=np.int64), np.full(len(rows), -1)
    # How many wrong lines in a row are passed over in the search for those that belong together.
    reach = 64
    for k in range(1, len(rows)):
        back = np.arange(max(0, k - reach), k)
        away = np.linalg.norm(offset[back] - offset[k], axis=1)
        flown = away <= FASTEST_M_S * (time[k] - time[back]) + room[back] + room[k]
        if flown.any():
            # Of chains that are equally long, the one without a gap.
            best = back[flown][::-1][int(np.argmax(count[back[flown]][::-1]))]
            count[k], came_from[k] = count[best] + 1, best
    together = usable & ~np.isfinite(listed.time_s)
    k = int(np.argmax(count))
    while k >= 0:
        together[rows[k]] = True
        k = int(came_from[k])
    return together


def _jumps(listed: ListedPositions, rows: Flags) -> Iterator[Finding]:
    """Name positions that lie where no aircraft came from the others' place in time."""
    if not rows.any():
        return
    others = np.isfinite(listed.place).all(axis=1) & ~rows
    origin = np.median(listed.place[others], axis=0)
    away = np.linalg.norm(_offsets(listed.place[rows], origin), axis=1)
    most = float(np.max(away))
    yield from _named("events-jump", rows, listed.lines, apart_m=most, fastest_m_s=FASTEST_M_S)


def judge_marks(lines: Sequence[str], time_s: Floats, accuracy_s: Floats) -> list[Finding]:
    """Judge time marks of a receiver, in the order of time: pulses that came twice, times not sure."""
    close = np.concatenate([[False], np.diff(time_s) < SAME_S])
    # A receiver that has fixes knows the time of a pulse to microseconds; one that is worse had none, s.
    unsure_s = 1e-3
    unsure = accuracy_s > unsure_s
    worst = float(np.max(accuracy_s, initial=0.0)) * 1e3
    return [
        *_named("events-twice", close, lines),
        *_named("marks-unsure", unsure, lines, accuracy_ms=worst, limit_ms=unsure_s * 1e3),
    ]


def judge_against_pictures(
    lines: Sequence[str], listed: Floats, listed_sigma: Floats, stated: Floats, stated_sigma: Floats
) -> tuple[Flags, list[Finding]]:
    """Compare listed positions with those that the pictures of the same exposures state, in plane.

    listed, stated (n, 3): latitude, longitude (deg), height (m); NaN where not known.
    listed_sigma, stated_sigma (n, 3): east, north, up, m; NaN where not stated.
    returns: which of them contradict, and what is to be said.
    """
    known = np.isfinite(listed).all(axis=1) & np.isfinite(stated[:, :2]).all(axis=1)
    wrong = np.zeros(len(listed), dtype=np.bool_)
    if not known.any():
        return wrong, []
    ours, theirs = in_plane(listed[known], stated[known])
    away = np.linalg.norm(ours - theirs, axis=1)
    own, other = (np.linalg.norm(sigma[known, :2], axis=1) for sigma in (listed_sigma, stated_sigma))
    precise = other > 0
    other = np.where(precise, other, PICTURE_SIGMA_M)
    late = np.where(precise, PICTURE_OFFSET_M, PICTURE_LATE_M)
    limit = SIGMAS * np.hypot(np.nan_to_num(own), other) + late
    wrong[known] = away > limit
    if not wrong.any():
        return wrong, []
    names = tuple(lines[k] for k in np.flatnonzero(wrong).tolist())
    many = wrong.sum() > known.sum() / 2
    figures = {"n": float(wrong.sum()), "all": float(known.sum()), "lines": names}
    figures |= {"apart_m": float(np.median(away[away > limit]))}
    code = "list-of-another-flight" if many else "events-beside-pictures"
    return wrong, [Finding(code, "grave" if many else "doubtful", figures=figures)]


def in_plane(listed: Floats, stated: Floats) -> tuple[Floats, Floats]:
    """East and north of both, m: heights may be of several kinds."""
    origin = np.median(listed, axis=0)
    ours, theirs = (
        _offsets(place, origin)[:, :2] for place in (listed, np.column_stack([stated[:, :2], listed[:, 2]]))
    )
    return ours, theirs


def judge_order(lines: Sequence[str], listed: Floats, stated: Floats) -> list[Finding]:
    """Find a list that has lost or gained lines and was numbered anew: those behind go with other pictures.

    lines: names of the rows, in the order of exposure.
    listed, stated (n, 3): latitude, longitude (deg), height (m); NaN where not known.
    """
    known = np.flatnonzero(np.isfinite(listed).all(axis=1) & np.isfinite(stated[:, :2]).all(axis=1))
    if not len(known):
        return []
    ours, theirs = in_plane(listed[known], stated[known])
    found = _shifted(ours, theirs)
    if found is None:
        return []
    at, by = found
    apart = float(np.median(np.linalg.norm(ours - theirs, axis=1)[at:]))
    figures = {"n": float(len(known) - at), "all": float(len(known)), "apart_m": apart, "by": float(abs(by))}
    cause = "lines-missing" if by > 0 else "lines-added"
    return [Finding("list-shifted", "grave", lines[known[at]], figures, cause=cause)]


def _shifted(ours: Floats, theirs: Floats) -> tuple[int, int] | None:
    """From which row on each is that of a later picture, or an earlier one (-), by how many; None as a rule.

    ours, theirs (n, 2): east and north of the list and of the pictures, m, in the order of exposure.

    Positions of pictures may be offset, and late by some seconds, from first to last: along the strips the
    difference is offset + late * spacing, and behind a lost line longer by one spacing (least squares).
    """
    # Rows on either side; how far a step is from whole spacings; what is left of them, and of the squares.
    fewest, whole, left, drop = 3, 0.25, 0.2, 0.5
    spacing = np.zeros_like(ours)
    ahead, back = ours[2:] - ours[1:-1], ours[1:-1] - ours[:-2]
    spacing[1:-1] = (ahead + back) / 2
    # Where an aircraft turns, the spacing of neighbours is none.
    straight = np.zeros(len(ours), dtype=np.bool_)
    straight[1:-1] = np.linalg.norm(ahead - back, axis=1) < np.linalg.norm(spacing[1:-1], axis=1) / 2
    rows = np.flatnonzero(straight)
    if len(rows) < 2 * fewest:
        return None
    apart, along = (ours - theirs)[rows], spacing[rows]
    steps, squares = _steps(apart, along)
    tried = slice(fewest, len(rows) - fewest + 1)
    count = fewest + int(np.argmin(squares[tried]))
    step = float(steps[count])
    by, typical = round(step), float(np.median(np.linalg.norm(along, axis=1)))
    steady = squares[count] <= min(len(rows) * (left * typical) ** 2, drop * squares[-1])
    if not by or abs(step - by) > whole or not steady:
        return None
    # The gap itself lies between, among rows that have no spacing: the first that is nearer to those behind.
    between = np.arange(rows[count - 1] + 1, rows[count] + 1)
    jump = (ours - theirs)[between] - apart[count - 1]
    nearer = np.linalg.norm(jump - by * along[count], axis=1) < np.linalg.norm(jump, axis=1)
    return int(between[int(np.argmax(nearer))]), by


def _steps(apart: Floats, along: Floats) -> tuple[Floats, Floats]:
    """Fit offset, lateness and a step behind each count of rows: steps in spacings, and the squares left.

    apart, along (n, 2): differences and spacings, m.
    returns: (n + 1,) each; behind all rows there is no step.
    """
    rows = np.zeros((len(apart), 2, 4))
    rows[:, 0, 0], rows[:, 1, 1], rows[:, :, 2] = 1.0, 1.0, along
    # Of the rows behind, the step has the column of the lateness.
    normal, right = np.einsum("nai,naj->nij", rows, rows), np.einsum("nai,na->ni", rows, apart)
    behind_normal, behind_right = (
        np.concatenate([np.cumsum(part[::-1], axis=0)[::-1], np.zeros_like(part[:1])])
        for part in (normal[:, :, 2], right[:, 2])
    )
    system = np.repeat(normal.sum(axis=0)[None], len(apart) + 1, axis=0)
    system[:, :, 3] = system[:, 3, :] = behind_normal
    system[:, 3, 3] = behind_normal[:, 2]
    sides = np.repeat(right.sum(axis=0)[None], len(apart) + 1, axis=0)
    sides[:, 3] = behind_right
    # Strips in one direction do not separate an offset from lateness: the shortest solution.
    found = np.einsum("nij,nj->ni", np.linalg.pinv(system, rcond=1e-10, hermitian=True), sides)
    return found[:, 3], np.sum(apart**2) - np.einsum("ni,ni->n", found, sides)
