"""What lies in the folder of a flight: pictures, control, marks, logs, and projects of other programs."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from photocal.base.errors import InputNotFoundError, PhotocalError
from photocal.base.layers import SUFFIXES as LAYERS
from photocal.base.layers import file_of, layers_of
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import Camera
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import SUFFIXES, UNREAD, require_names
from photocal.measurement.marks import ControlMarks
from photocal.measurement.position_files import UnbelievableListError, is_event_table, read_positions
from photocal.run.control_files import (
    READERS,
    TABLES,
    Sizes,
    control_of,
    means_control,
    with_system_beside,
)
from photocal.run.stage import MEMORY

_LOGS, _RAW_LOGS = (".mcap",), (".tlog", ".bin", ".ulg", ".ubx")
_NOT_TAKEN = (".xls", ".kml", ".kmz", ".dxf", ".dwg", ".gpx", ".gdb", ".tab", ".mif")
# Files of a project, by their programs.
_COMPUTED = {
    "Pix4D": (
        "*calibrated_*camera_parameters*.txt", "*calibrated_images_position*.txt", "*calibrated_rig_*.txt",
        "*_gcps_position.txt", "*_tp_*.txt", "*_pmatrix.txt",
    ),
    "ODM": ("shots.geojson",),
    "MicMac": ("orientation-*.xml", "autocal_*.xml"),
    "MMVII": ("ori-perspcentral-*.xml", "calib-perspcentral-*.xml"),
}  # fmt: skip

# Those whose projects no command reads.
_NOT_READ = ("MMVII",)


@dataclass
class FolderContents:
    """What a folder has, in the order of its names.

    pictures: of each folder with pictures that can be read, at the positions that a table beside them gives.
    positions: such tables.
    cams: cameras of Pix4D's .cam files.
    unread: pictures and tables that cannot be used, with the reason.
    """

    folder: Path
    pictures: dict[Path, tuple[ImageFacts, ...]] = field(default_factory=dict)
    control: list[ControlMarks] = field(default_factory=list)
    marks: list[ControlMarks] = field(default_factory=list)
    logs: list[Path] = field(default_factory=list)
    raw_logs: list[Path] = field(default_factory=list)
    events: list[Path] = field(default_factory=list)
    positions: list[Path] = field(default_factory=list)
    cams: dict[Path, tuple[Camera, ...]] = field(default_factory=dict)
    unread: list[str] = field(default_factory=list)


def survey(folder: Path, say: Catalogue, leave_out: Collection[Path] = ()) -> FolderContents:
    """Look at everything in a folder; raises InputNotFoundError when it is not a folder.

    leave_out: files that are no source of anything.
    """
    if not folder.is_dir():
        raise InputNotFoundError("is not a folder", "name the folder of the flight", where=folder)
    seen = FolderContents(folder)
    # Folders that are looked into, one in another.
    depth = 3
    files = sorted(path for path in _files(folder, depth, set()) if path not in leave_out)
    seen.pictures = _pictures(files, seen.unread)
    seen.unread += _without_twin(files, say)
    sizes = _sizes(seen.pictures)
    results = _results(files, seen, say)
    others = [path for path in files if path not in results]
    for path in [part for file in others for part in _parts(file, seen.unread)]:
        kind = file_of(path).suffix.lower()
        if kind in _LOGS:
            seen.logs.append(path)
        elif kind in _RAW_LOGS and path.stem not in ("cameras", "images", "points3D"):
            seen.raw_logs.append(path)
        elif kind == ".cam":
            _with_cameras(path, sizes, seen)
        elif _lists_events(path):
            seen.events.append(path)
        elif (
            kind in (*TABLES, *LAYERS)
            and (placed := _placed(path, seen.pictures, seen.unread, say)) is not None
        ):
            # What cannot be right is named, and gives no picture a place.
            if placed is not seen.pictures:
                seen.positions.append(path)
            seen.pictures = placed
        elif kind in READERS:
            _with_control(path, files, sizes, seen, say)
    # Whoever has points in one of these finds no word of them otherwise.
    seen.unread += [
        say("new.not_taken", place=path)
        for path in files
        if path.suffix.lower() in _NOT_TAKEN and (not seen.control or means_control(path))
    ]
    return seen


def _parts(path: Path, unread: list[str]) -> tuple[Path, ...]:
    """The sheets or layers of a file that has such, else the file."""
    if path.suffix.lower() not in LAYERS:
        return (path,)
    try:
        return layers_of(path)
    except PhotocalError as refusal:
        unread.append(str(refusal))
        return ()


def _lists_events(path: Path) -> bool:
    """Whether a file lists events of a camera, without the names of pictures."""
    name = path.name.lower()
    return name.endswith((".mrk", "_events.pos")) or (name.endswith(TABLES) and is_event_table(path))


def _sizes(pictures: dict[Path, tuple[ImageFacts, ...]]) -> Sizes:
    """Sizes of pictures by name; of a name that comes twice by folder and name, too."""
    called = Counter(image.name for facts in pictures.values() for image in facts)
    sizes = {image.name: image.size_px for facts in pictures.values() for image in facts}
    return sizes | {
        f"{where.name}/{image.name}": image.size_px
        for where, facts in pictures.items()
        for image in facts
        if called[image.name] > 1
    }


def _results(files: Sequence[Path], seen: FolderContents, say: Catalogue) -> set[Path]:
    """What other programs have computed: no observation, and named once for each folder."""
    found = {path: program for path in files for program, names in _COMPUTED.items() if _named(path, names)}
    for where, program in dict.fromkeys((path.parent, program) for path, program in found.items()):
        inner = where.relative_to(seen.folder).as_posix()
        here = say("new.the_folder") if where == seen.folder else inner
        key = "new.computed_only" if program in _NOT_READ else "new.computed"
        seen.unread.append(say(key, where=here, program=program, folder=where))
    return set(found)


def _named(path: Path, patterns: Sequence[str]) -> bool:
    return any(fnmatch(path.name.casefold(), pattern) for pattern in patterns)


def _with_cameras(path: Path, sizes: Sizes, seen: FolderContents) -> None:
    """Cameras of a .cam file of Pix4D; that of Inpho beside it has no distortion, and is passed over."""
    from photocal.exchange.pix4d_project import read_cam

    try:
        seen.cams[path] = read_cam(path, dict.fromkeys(sizes.values()))
    except PhotocalError as refusal:
        if "pix4d" in path.name.casefold():
            seen.unread.append(str(refusal))


def _pictures(files: Sequence[Path], unread: list[str]) -> dict[Path, tuple[ImageFacts, ...]]:
    """What the pictures of each folder say of themselves."""
    pictures: dict[Path, list[ImageFacts]] = {}
    for path in files:
        if path.suffix.lower() in SUFFIXES:
            try:
                require_names([path])
                facts = read_facts(path)
                pictures.setdefault(path.parent, []).append(facts)
            except PhotocalError as refusal:
                unread.append(str(refusal))
    return {where: tuple(facts) for where, facts in pictures.items()}


def _without_twin(files: Sequence[Path], say: Catalogue) -> Iterator[str]:
    """Name pictures of kinds that are not read, where none that is read has their name."""
    twins = {path.stem.casefold() for path in files if path.suffix.lower() in SUFFIXES}
    left = Counter(
        (path.parent, path.suffix.lower())
        for path in files
        if path.suffix.lower() in UNREAD and path.stem.casefold() not in twins
    )
    for (where, kind), count in left.items():
        yield say("new.pictures_unread", n=count, kind=kind, folder=where)


def _placed(
    path: Path, pictures: dict[Path, tuple[ImageFacts, ...]], unread: list[str], say: Catalogue
) -> dict[Path, tuple[ImageFacts, ...]] | None:
    """Pictures at the positions of a table that names them; None for another table."""
    every = [image for facts in pictures.values() for image in facts]
    try:
        given = read_positions(path, every)
    except UnbelievableListError as refusal:
        unread.append(str(refusal))
        return pictures
    except PhotocalError:
        return None
    placed = {where: tuple(map(given, facts)) for where, facts in pictures.items()}
    if slip := _elsewhere(every, [image for facts in placed.values() for image in facts]):
        unread.append(f"{path}: {say(f'new.table_{slip}')}")
        return pictures
    return placed


def _elsewhere(stated: Sequence[ImageFacts], listed: Sequence[ImageFacts]) -> str:
    """Which slip of a table puts its pictures nowhere near where they say that they are; empty for none."""
    both = [
        ((own.latitude_deg, own.longitude_deg), (other.latitude_deg, other.longitude_deg))
        for own, other in zip(stated, listed, strict=True)
        if own.has_position and other.altitude_kind == "table"
    ]
    if not both:
        return ""
    own, put = np.array(both).transpose(1, 0, 2)
    # No flight is so wide, and no datum so far, deg.
    far_deg = 0.05
    ways = {
        "": put,
        "west": put * [1, -1],
        "south": put * [-1, 1],
        "exchanged": put[:, ::-1],
    }
    near = (way for way, there in ways.items() if np.median(np.abs(there - own).max(axis=1)) < far_deg)
    return next(near, "far")


def _files(folder: Path, depth: int, been: set[Path]) -> Iterator[Path]:
    """Files of a folder and those below it; neither hidden ones nor what a run has made.

    been: folders that links need not lead to again.
    """
    been.add(folder.resolve())
    for path in sorted(folder.iterdir(), key=Path.is_symlink):
        if path.name.startswith("."):
            continue
        if path.is_file():
            yield path
        elif depth and path.is_dir() and path.resolve() not in been and not (path / MEMORY).exists():
            yield from _files(path, depth - 1, been)


def _with_control(
    path: Path, files: Sequence[Path], sizes: Sizes, seen: FolderContents, say: Catalogue
) -> None:
    """Control or marks of a file, if it has them."""
    control = control_of(path, sizes, seen.unread, say)
    if control is None:
        return
    if control.points.names:
        seen.control.append(with_system_beside(control, files, seen.unread, say))
    else:
        seen.marks.append(control)
