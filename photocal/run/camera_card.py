"""The card of a DJI camera: its pictures by lens and flight, and what on it is no picture of a flight.

`DCIM` has folders such as `100MEDIA`, `100_0001` or `DJI_202206021430_001_name`. A camera of several lenses
writes one picture each and ends its name with a letter: `_W` wide, `_Z` zoom, `_T` thermal, `_V` visible,
`_D` colour beside the bands `_MS_G`, `_MS_R`, `_MS_RE`, `_MS_NIR`, `_S` what its screen showed. Panoramas and
hyperlapses have folders of their own, and thumbnails lie in `THM`. Source: folders of DJI's cameras.
"""

import datetime as dt
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from glob import escape
from itertools import takewhile
from os.path import commonpath
from pathlib import Path

import numpy as np

from photocal.findings.texts import Catalogue
from photocal.measurement.image_facts import ImageFacts, is_edited
from photocal.measurement.maker_camera import HeadGroup, recognised_heads

# Lenses in the order in which a block is made of their pictures; "" is a camera of one lens.
LENSES = {
    "W": "wide",
    "V": "visible",
    "D": "colour",
    "": "only lens",
    "MS": "bands",
    "Z": "zoom",
    "T": "thermal",
}
# What stands in such folders or ends so is no picture of a block.
ASIDE = {
    "panorama": "panoramas", "pano": "panoramas", "hyperlapse": "hyperlapses", "timelapse": "time lapses",
    "thm": "thumbnails", "thumbnail": "thumbnails", "thumbnails": "thumbnails", "misc": "thumbnails",
    "s": "pictures of the screen", "scr": "pictures of the screen",
}  # fmt: skip
# Pictures with a longer pause between them are of two flights, s.
PAUSE_S = 600.0
_MEDIA = re.compile(r"(?i)\d{3}_?(media|\d{4})|dji_\d{12}_\d{3}(_.*)?|dcim|panorama|hyperlapse")
_MISSION = re.compile(r"(?i)dji_\d{12}_\d{3}(_.*)?")
_NAME = re.compile(r"(?i)(?:dji|\d{3}|pano|max|hyperlapse)_.*?(?:\d{3,5})(?:_([A-Z]+(?:_[A-Z]+)?))?")
Pictures = Mapping[Path, tuple[ImageFacts, ...]]


@dataclass(frozen=True)
class ChosenPictures:
    """Pictures that a project is made of, and the others.

    pictures: under the folder, or the pattern of names, that stands for them alone.
    folder, facts: of those that are used. place: their files, by name.
    frame: where several cameras expose together.
    events: lists of exposures that belong to them.
    known, missing: what was sorted, and what is left out that somebody might want, a sentence each.
    """

    pictures: dict[Path, tuple[ImageFacts, ...]]
    folder: Path | None
    facts: tuple[ImageFacts, ...]
    place: Mapping[str, Path]
    frame: HeadGroup | None
    events: tuple[Path, ...]
    known: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()

    def alike_elsewhere(self) -> frozenset[str]:
        """Pictures of other folders, with their folders, that are called as those that are used."""
        used = {image.name for image in self.facts}
        elsewhere = (where for where in self.pictures if self.frame is None and where != self.folder)
        return frozenset(
            f"{where.name}/{image.name}"
            for where in elsewhere
            for image in self.pictures[where]
            if image.name in used
        )


def chosen_pictures(
    folder: Path, pictures: Pictures, events: Sequence[Path], say: Catalogue
) -> ChosenPictures:
    """Choose pictures: of a card those of one lens, else all of a frame, or one flight of a camera."""
    card = _sorted_card(folder, pictures, events, say)
    if card is not None:
        return card
    paths = {where / image.name: image for where, some in pictures.items() for image in some}
    frame = recognised_heads(paths)
    if frame is not None:
        facts = {path: image for path, image in paths.items() if path in frame.head}
        root = Path(commonpath([path.parent for path in frame.head]))
        place = {path.name: path for path in facts}
        return ChosenPictures(dict(pictures), root, tuple(facts.values()), place, frame, tuple(events))
    if not pictures:
        return ChosenPictures({}, None, (), {}, None, tuple(events))
    return _one_flight(folder, pictures, events, say)


def _one_flight(folder: Path, pictures: Pictures, events: Sequence[Path], say: Catalogue) -> ChosenPictures:
    """Take the largest folder, and others of its camera and flight: cards begin new ones as they fill."""
    # Of copies those that nobody has edited.
    order = sorted(
        pictures, key=lambda where: (sum(map(is_edited, pictures[where])), len(where.parts), where)
    )
    largest = max(order, key=lambda where: len(pictures[where]))
    own = set(map(_camera, pictures[largest]))
    whole = [
        where
        for where, some in pictures.items()
        if where != largest
        and any(map(any, own))
        and not any(_aside(folder, where / image.name) for image in some)
    ]
    copies = [where for where in whole if _again(pictures[where], pictures[largest])]
    whole = [where for where in whole if where not in copies]
    alike = [where for where in whole if own.issuperset(map(_camera, pictures[where]))]
    joined = _joined(largest, alike, pictures)
    paths = {where / image.name: image for where, some in pictures.items() for image in some}
    pattern, taken, apart = _readable([path for path in paths if path.parent in joined], paths)
    missing = [say("new.card_apart", folder=where.relative_to(folder).as_posix()) for where in sorted(apart)]
    missing += [
        say(
            "new.folder_copies",
            n=len(pictures[where]),
            folder=where.relative_to(folder).as_posix(),
            used=largest.relative_to(folder).as_posix(),
        )
        for where in copies
    ]
    for where in (where for where in whole if where not in joined):
        both, fits, _ = _readable([path for path in paths if path.parent in (*joined, where)], paths)
        if any(path.parent == where for path in fits):
            told = {"n": len(pictures[where]), "folder": where.relative_to(folder).as_posix()}
            told |= {"both": both.relative_to(folder).as_posix(), "camera": _called(pictures[where][0])}
            hours = _pause_s(pictures[where], pictures[largest]) / 3600
            key = "new.folder_flight" if where in alike else "new.folder_camera"
            missing.append(say(key, hours=say.fixed(hours, 1), **told))
    used = {path.parent for path in taken}
    left = {where: some for where, some in pictures.items() if where not in used}
    known = []
    if len(used) > 1:
        names = ", ".join(sorted(where.relative_to(folder).as_posix() for where in used))
        known.append(say("new.folders_joined", n=len(used), names=names))
    facts, place = tuple(paths[path] for path in taken), {path.name: path for path in taken}
    return ChosenPictures(
        {pattern: facts, **left}, pattern, facts, place, None, tuple(events), tuple(known), tuple(missing)
    )


def _joined(largest: Path, alike: Sequence[Path], pictures: Pictures) -> list[Path]:
    """The folders that belong to the flight of the largest one, directly or by another."""
    joined, waiting = [largest], list(alike)
    while near := [
        where for where in waiting if any(_pause_s(pictures[where], pictures[of]) <= PAUSE_S for of in joined)
    ]:
        joined += near
        waiting = [where for where in waiting if where not in near]
    return joined


def _camera(image: ImageFacts) -> tuple[str, ...]:
    """What a picture says of its camera; empty texts where it says nothing."""
    band = image.maker_camera.get("RigCameraIndex", "")
    size = "x".join(map(str, image.size_px)) if image.make or image.model else ""
    return image.make, image.model, image.serial, str(band), size


def _called(image: ImageFacts) -> str:
    return " ".join(filter(None, (image.model or image.make, image.serial))) or "?"


def _again(some: Sequence[ImageFacts], others: Sequence[ImageFacts]) -> bool:
    """Whether most of some pictures are exposures of the others: copies under other names or endings."""
    exposures = {_exposure(image) for image in others if image.taken}
    endings = {Path(image.name).stem: Path(image.name).suffix.lower() for image in others}

    def converted(image: ImageFacts) -> bool:
        """Whether another picture has its name and another ending."""
        name = Path(image.name)
        return endings.get(name.stem, name.suffix.lower()) != name.suffix.lower()

    return 2 * sum(_exposure(image) in exposures or converted(image) for image in some) > len(some)


def _exposure(image: ImageFacts) -> tuple[str, float, float]:
    """When and where a picture was taken."""
    place = (image.latitude_deg, image.longitude_deg) if image.has_position else (0.0, 0.0)
    return image.taken, *place


def _pause_s(some: Sequence[ImageFacts], others: Sequence[ImageFacts]) -> float:
    """Seconds between the end of one set of pictures and the begin of the other; none without times."""
    times = [sorted(image.taken for image in facts if image.taken) for facts in (some, others)]
    if not all(times):
        return 0.0
    first, then = sorted(times)
    return max(_apart_s(first[-1], then[0]), 0.0)


def _readable(wanted: Sequence[Path], paths: Mapping[Path, ImageFacts]) -> tuple[Path, list[Path], set[Path]]:
    """The folder or pattern of names for pictures, those that it stands for, and folders of the others."""
    kept, twice = _once(wanted)
    pattern = _pattern(kept, paths.keys() - set(kept))
    taken = [path for path in kept if path.parent == pattern or _fits(path, pattern)]
    return pattern, taken, {path.parent for path in (set(kept) - set(taken)) | twice}


def _sorted_card(
    folder: Path, pictures: Pictures, events: Sequence[Path], say: Catalogue
) -> ChosenPictures | None:
    """Sort the pictures of a card; None where nothing is to be sorted, or the folder is no card."""
    paths = {where / image.name: image for where, some in pictures.items() for image in some}
    # Lenses of one gimbal are distinguished by names alone, too, where the folders of the card are gone.
    gimbal = {"W", "V", "Z", "T"}
    several = len(gimbal & {_lens(path.name) for path in paths}) > 1
    inner = (part for path in paths for part in path.relative_to(folder).parts[:-1])
    if not several and not any(map(_MEDIA.fullmatch, inner)):
        return None
    aside, lenses = defaultdict[str, list[Path]](list), defaultdict[str, list[Path]](list)
    for path in sorted(paths):
        lens, kind = _lens(path.name), _aside(folder, path)
        (aside[kind] if kind else lenses[lens]).append(path)
    # Cameras of a frame expose together, and their names tell it; lenses on one gimbal see other light.
    bands = set(lenses) <= {"", "MS"}
    if not lenses or (not aside and bands and (len(pictures) == 1 or recognised_heads(paths))):
        return None
    known = [
        say("new.card_aside", n=len(some), kind=say(f"new.told.{kind}"))
        for kind, some in sorted(aside.items())
    ]
    missing, sets, place = list[str](), dict[Path, tuple[ImageFacts, ...]](), dict[str, Path]()
    for lens in sorted(lenses, key=lambda lens: (_place(lens), lens)):
        pattern, taken, apart = _readable(lenses[lens], paths)
        sets[pattern] = tuple(paths[path] for path in taken)
        place = place or {path.name: path for path in taken}
        known.append(_sentence(lens, {path: paths[path] for path in taken}, say))
        missing += [
            say("new.card_apart", folder=where.relative_to(folder).as_posix()) for where in sorted(apart)
        ]
    first = next(iter(sets))
    # Each list counts its own flight; pictures of another have the same numbers.
    own = tuple(path for path in events if path.parent in (first, first.parent))
    if len(own) < len(events) and not all(np.isfinite(image.position_sigma_m).all() for image in sets[first]):
        missing.append(say("new.card_events"))
    return ChosenPictures(
        sets, first, sets[first], place, None, own, tuple(known), tuple(dict.fromkeys(missing))
    )


def flights_of(pictures: Mapping[Path, ImageFacts]) -> tuple[tuple[ImageFacts, ...], ...]:
    """Pictures by flight: between two lies a pause, or another folder of a mission."""
    timed = sorted(pictures, key=lambda path: (pictures[path].taken, path))
    flights, last, where = list[list[ImageFacts]](), "", Path()
    for path in timed:
        image = pictures[path]
        other = path.parent != where and bool(_MISSION.fullmatch(path.parent.name))
        if not flights or other or (last and image.taken and _apart_s(last, image.taken) > PAUSE_S):
            flights.append([])
        flights[-1].append(image)
        last, where = image.taken, path.parent
    return tuple(tuple(flight) for flight in flights)


def _apart_s(first: str, then: str) -> float:
    return (dt.datetime.fromisoformat(then) - dt.datetime.fromisoformat(first)).total_seconds()


def _sentence(lens: str, pictures: Mapping[Path, ImageFacts], say: Catalogue) -> str:
    flights = flights_of(pictures)
    what = say("new.card_lens", lens=lens) if lens else say("new.card_one_lens")
    if LENSES.get(lens):
        what = f"{what} ({say(f'new.told.{LENSES[lens]}')})"
    times = (flight[0].taken.replace("T", " ") for flight in flights)
    each = (
        say("new.card_flight", n=len(flight), time=time) if time else f"{len(flight)}"
        for flight, time in zip(flights, times, strict=True)
    )
    count = say("new.card_flights", n=len(flights)) if len(flights) > 1 else say("new.card_one_flight")
    return say("new.card_pictures", lens=what, n=len(pictures), flights=count, each="; ".join(each))


def _lens(name: str) -> str:
    """Letters of the lens at the end of a name; empty for a camera of one."""
    found = _NAME.fullmatch(Path(name).stem)
    letters = (found[1] or "").upper() if found else ""
    return letters.partition("_")[0]


def _place(lens: str) -> int:
    order = list(LENSES)
    return order.index(lens) if lens in order else len(order)


def _aside(folder: Path, path: Path) -> str:
    """What a picture is that is none of a block; empty for one that is."""
    parts = [part.casefold() for part in path.relative_to(folder).parts[:-1]]
    kind = next((ASIDE[part] for part in parts if part in ASIDE), "")
    if kind:
        return kind
    words = re.split(r"[_\-]", path.stem.casefold())
    return ASIDE.get(words[-1], "") or (ASIDE["pano"] if words[0] == "pano" else "")


def _once(paths: Sequence[Path]) -> tuple[list[Path], set[Path]]:
    """Pictures whose names come once, and the others; of folders with equal names the larger one stays."""
    of = defaultdict[Path, list[Path]](list)
    for path in paths:
        of[path.parent].append(path)
    kept, taken, left = list[Path](), set[str](), set[Path]()
    for where in sorted(of, key=lambda where: (-len(of[where]), where)):
        names = {path.name for path in of[where]}
        if names & taken:
            left.update(of[where])
        else:
            kept += of[where]
            taken |= names
    return sorted(kept), left


def _pattern(kept: Sequence[Path], others: Iterable[Path]) -> Path:
    """The folder that has these pictures alone, or a pattern of names for as many of them as one has."""
    folders = sorted({path.parent for path in kept})
    if len(folders) == 1 and not any(path.parent == folders[0] for path in others):
        return folders[0]
    root = folders[0] if len(folders) == 1 else Path(commonpath(folders))
    parts = [folder.relative_to(root).parts for folder in folders]
    if len({len(part) for part in parts}) > 1:
        most = max(folders, key=lambda folder: sum(path.parent == folder for path in kept))
        return _pattern([path for path in kept if path.parent == most], others)
    names = [path.name for path in kept]
    for alike in (_begin_and_end, _letter_by_letter):
        pattern = root.joinpath(*(alike(at) for at in zip(*parts, strict=True)), alike(names))
        if not any(_fits(path, pattern) for path in others):
            break
    return pattern


def _begin_and_end(names: Sequence[str]) -> str:
    """A pattern for all of several names: what they begin and end with, and * between."""
    if len(set(names)) == 1:
        return escape(names[0])
    # Digits that happen to be the same tell nothing.
    begin = _common_begin(names).rstrip("0123456789")
    end = _common_begin([name[len(begin) :][::-1] for name in names])[::-1].lstrip("0123456789")
    return f"{escape(begin)}*{escape(end)}"


def _common_begin(names: Sequence[str]) -> str:
    same = takewhile(lambda at: len(set(at)) == 1, zip(*names, strict=False))
    return "".join(at[0] for at in same)


def _letter_by_letter(names: Sequence[str]) -> str:
    """The same for names of one length: ? for a letter that varies."""
    if len({len(name) for name in names}) > 1:
        return _begin_and_end(names)
    letters = zip(*names, strict=True)
    return "".join(escape(at[0]) if len(set(at)) == 1 else "?" for at in letters)


def _fits(path: Path, pattern: Path) -> bool:
    """Whether a file is one of a pattern of names."""
    pairs = zip(path.parts, pattern.parts, strict=False)
    return len(path.parts) == len(pattern.parts) and all(
        name == part or fnmatchcase(name, part) for name, part in pairs
    )
