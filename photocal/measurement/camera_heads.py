"""Cameras on one frame, recognised_heads by the names of their pictures: which belong to one exposure."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from photocal.measurement.image_facts import ImageFacts

# More heads than this are no frame but a count of pictures; fewer exposures show no pattern; a head misses a
# few exposures only; pictures of one exposure are this close in time, s.
MOST_HEADS, FEWEST_EXPOSURES, MISSED, TOGETHER_S = 12, 2, 0.5, 3.0
_PARTS = re.compile(r"[_\-. ]+")
Keys = dict[Path, tuple[str, str]]


@dataclass(frozen=True)
class HeadGroup:
    """Pictures of several cameras that expose together.

    heads: names of the heads, the one that the others refer to first.
    head, exposure: of each picture, by its path; pictures that belong to none are missing.
    by: what tells it: "names" or "folders".
    """

    heads: tuple[str, ...]
    head: Mapping[Path, str]
    exposure: Mapping[Path, str]
    by: str


def recognised_heads(pictures: Mapping[Path, ImageFacts]) -> HeadGroup | None:
    """Recognise pictures of cameras on one frame; None where each picture stands for itself."""
    for by, split in (("names", _by_name), ("folders", _by_folder)):
        if frames := list(split(pictures, by)):
            return max(frames, key=lambda frame: len(frame.head))
    return None


def _by_name(pictures: Mapping[Path, ImageFacts], by: str) -> Iterable[HeadGroup]:
    """One part of the names tells the heads, the others the exposure."""
    for at in (-1, 0, -2):
        keys: Keys = {}
        for path in pictures:
            parts = _PARTS.split(path.stem)
            if len(parts) >= max(2, abs(at)):
                head = parts[at]
                keys[path] = head, "_".join(part for k, part in enumerate(parts) if k != at % len(parts))
        yield from _frame(pictures, keys, by)


def _by_folder(pictures: Mapping[Path, ImageFacts], by: str) -> Iterable[HeadGroup]:
    """Folders with equally many pictures hold a head each, and the pictures follow in their order."""
    folders = defaultdict[Path, list[Path]](list)
    for path in sorted(pictures):
        folders[path.parent].append(path)
    counts = {len(paths) for paths in folders.values()}
    names = [folder.name for folder in folders]
    if len(counts) == 1 and len(set(names)) == len(names) > 1:
        keys = {
            path: (folder.name, f"{k:05}")
            for folder, paths in folders.items()
            for k, path in enumerate(paths, start=1)
        }
        yield from _frame(pictures, keys, by)


def _frame(pictures: Mapping[Path, ImageFacts], keys: Keys, by: str) -> Iterable[HeadGroup]:
    """Give the frame of a division into heads and exposures, if it is one."""
    heads = Counter(head for head, _ in keys.values())
    exposures = defaultdict[str, list[Path]](list)
    for path, (_, exposure) in keys.items():
        exposures[exposure].append(path)
    shared = {name: paths for name, paths in exposures.items() if len(paths) > 1}
    often = [head for head, count in heads.items() if count >= MISSED * len(exposures)]
    if not (1 < len(often) <= MOST_HEADS) or len(shared) < max(FEWEST_EXPOSURES, MISSED * len(exposures)):
        return
    head = {path: name for path, (name, _) in keys.items() if name in often}
    for name in often:
        # A head is one camera.
        if len({_camera_key(pictures[path]) for path, other in head.items() if other == name}) > 1:
            return
    if all(_together([pictures[path] for path in paths]) for paths in shared.values()):
        order = sorted(often, key=lambda name: _rank(name, head, pictures))
        yield HeadGroup(tuple(order), head, {path: keys[path][1] for path in head}, by)


def _camera_key(facts: ImageFacts) -> tuple[object, ...]:
    return facts.make, facts.model, facts.size_px, facts.maker_camera.get("RigCameraIndex", "")


def _together(facts: Sequence[ImageFacts]) -> bool:
    """Whether pictures were taken at one time; without times they may have been."""
    stated = [image.maker_camera for image in facts]
    captures = {tags[key] for tags in stated for key in ("CaptureUUID", "CaptureId") if key in tags}
    times = [datetime.fromisoformat(image.taken).timestamp() for image in facts if image.taken]
    return len(captures) < 2 and (not times or max(times) - min(times) < TOGETHER_S)


def _rank(name: str, head: Mapping[Path, str], pictures: Mapping[Path, ImageFacts]) -> tuple[int, str]:
    """The head that its maker numbers 0 comes first, then by number and name."""
    first = next(path for path, other in head.items() if other == name)
    index = pictures[first].maker_camera.get("RigCameraIndex", "")
    return (int(index) if index.isdigit() else MOST_HEADS), name
