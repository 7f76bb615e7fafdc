"""Control as people type it, reviewed before any work: duplicates, blunders, single marks."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from photocal.base.arrays import Floats
from photocal.block.model import ObjectPoints
from photocal.exchange.parts import Mark
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue
from photocal.geometry.frames import code_of, level_of, system_of
from photocal.measurement.place_tables import FOOT_M

# A point so far from the others, and so many times as far as they are from each other, is none of the site.
FAR_M, FARTHER = 2_000.0, 20.0
# Two names within so much, and within this share of the whole width, may be one point; one place, m.
TWIN_M, TWIN_SHARE, SAME_M = 1.0, 0.02, 0.002
# Neighbouring zones that are tried.
ZONES = (-1, 1, -2, 2)


def stray_text(stray: Finding, say: Catalogue) -> str:
    """Say what `stray_points` has found, before anything is left out."""
    km, zone = stray.figures["km"], stray.figures["zone"]
    slip = (say(f"clause.{slip}", zone=zone) for slip in stray.clauses)
    return "".join([say("new.control_far", name=stray.subject, km=f"{km:.0f}"), *slip])


def stray_points(points: ObjectPoints, crs: str) -> dict[int, Finding]:
    """Find points far from where most of the others are, with the typing error that would explain it.

    returns: by the row of the point.
    """
    places = points.values[:, :2]
    known = np.isfinite(places).all(axis=1) & ~points.of_role("tie")
    if known.sum() < 3:
        return {}
    middle = np.median(places[known], axis=0)
    away = np.linalg.norm(places - middle, axis=1)
    usual = float(np.median(away[known]))
    limit = max(FAR_M, FARTHER * usual)
    far = np.flatnonzero(known & (away > limit))
    # Of two heaps of alike size neither is the site.
    if 2 * len(far) >= known.sum():
        return {}
    found = {}
    for k in far.tolist():
        slip, zone = _slip(places[k], middle, limit, crs)
        figures = {"km": float(away[k]) / 1000, "zone": zone}
        clauses = (slip,) if slip else ()
        found[k] = Finding("control-far", "doubtful", points.names[k], figures, clauses)
    return found


def _slip(place: Floats, middle: Floats, limit: float, crs: str) -> tuple[str, str]:
    """Code of the slip that explains a place, and the zone where it is one."""
    if np.linalg.norm(place[::-1] - middle) <= limit:
        return "far-exchanged", ""
    if np.linalg.norm(place * FOOT_M - middle) <= limit:
        return "far-in-feet", ""
    zones = (name for name, moved in _of_other_zones(place, crs) if np.linalg.norm(moved - middle) <= limit)
    zone = next(zones, "")
    return ("far-in-zone", zone) if zone else ("", "")


def _of_other_zones(place: Floats, crs: str) -> Iterator[tuple[str, Floats]]:
    """Where a place would lie if it were in a neighbouring zone of the system."""
    if not crs or crs == "local":
        return
    from pyproj import Transformer
    from pyproj.exceptions import CRSError, ProjError

    try:
        level = level_of(system_of(crs))
        register, _, code = code_of(level).partition(":")
        if not code.isdecimal():
            return
        for step in ZONES:
            other = system_of(f"{register}:{int(code) + step}")
            # Of the same family: zones differ in their number alone.
            if other.is_projected and _family(other.name) == _family(level.name):
                way = Transformer.from_crs(other, level, always_xy=True)
                yield f"{code_of(other)} ({other.name})", np.array(way.transform(*place))
    except (CRSError, ProjError):
        return


def _family(name: str) -> str:
    return "".join(letter for letter in name if not letter.isdigit()).rstrip("NSEW ")


def twins(points: ObjectPoints, say: Catalogue) -> Iterator[str]:
    """Points that are at one place, or so near that two names may mean one, and names that differ little."""
    called: dict[str, str] = {}
    for name in points.names:
        other = called.setdefault(name.casefold(), name)
        if other != name:
            yield say("new.twins_called", one=other, other=name)
    known = np.flatnonzero(np.isfinite(points.values).all(axis=1) & ~points.of_role("tie"))
    if len(known) < 2:
        return
    width = float(np.linalg.norm(np.ptp(points.values[known, :2], axis=0)))
    near = max(SAME_M, min(TWIN_M, TWIN_SHARE * width))
    for i, j in combinations(known, 2):
        apart = points.values[i] - points.values[j]
        level, names = float(np.hypot(*apart[:2])), {"one": points.names[i], "other": points.names[j]}
        if level > near:
            continue
        if level > SAME_M:
            yield say("new.twins_near", **names, apart=say.fixed(level, 2))
        elif abs(apart[2]) > SAME_M:
            first, second = (say.as_given(points.values[k, 2]) for k in (i, j))
            yield say("new.twins_heights", **names, first=first, second=second)
        else:
            yield say("new.twins", **names)


def heights_apart(points: ObjectPoints, say: Catalogue) -> Iterator[str]:
    """Heights of zero, and such that would agree with the others in feet, or with the other sign."""
    heights = points.values[:, 2]
    known = np.flatnonzero(np.isfinite(points.values).all(axis=1) & ~points.of_role("tie"))
    if len(known) < 3:
        return
    middle = float(np.median(heights[known]))
    if np.ptp(heights[known]) == 0.0:
        yield say("new.heights_alike", n=len(known), height=say.as_given(middle))
    usual = float(np.median(np.abs(heights[known] - middle)))
    width = float(
        np.linalg.norm(np.ptp(np.sort(points.values[known, :2], axis=0)[len(known) // 6 :], axis=0))
    )
    limit = max(20.0 * usual, 0.2 * min(width, 1000.0), 5.0)
    for k in known:
        if heights[k] == 0.0 and abs(middle) > limit:
            yield say("new.height_zero", point=points.names[k], middle=say.fixed(middle, 1))
            continue
        for slip, there in (("new.height_feet", heights[k] * FOOT_M), ("new.height_sign", -heights[k])):
            if abs(heights[k] - middle) > limit and abs(there - middle) < 0.1 * limit + usual:
                yield say(slip, point=points.names[k], height=say.as_given(heights[k]))


def alone(marks: Sequence[Mark], points: ObjectPoints, say: Catalogue) -> Iterator[str]:
    """Points with one mark, which say nothing of their own place."""
    count = Counter(mark.point for mark in marks)
    single = [name for name in points.names if count[name] == 1]
    if single:
        yield say("new.marked_once", names=listed(single, say))
    bare = [name for name in points.names if not count[name]]
    if bare and count:
        yield say("new.without_mark", names=listed(bare, say))


def listed(names: Sequence[str], say: Catalogue) -> str:
    """Some names, and how many more there are."""
    # More names are no sentence.
    most_named = 5
    some = ", ".join(names[:most_named])
    return some if len(names) <= most_named else say("new.named_more", names=some, n=len(names) - most_named)
