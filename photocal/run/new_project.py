"""`photocal new`: a commented project file of what a folder has, and what is missing."""

import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.errors import InputNotFoundError, OutputError, PhotocalError
from photocal.base.files import output_file, rows_text
from photocal.base.policy import policy
from photocal.block.model import NO_POINTS, ROLES, ObjectPoints
from photocal.block.network import OTHER_SURFACE_M
from photocal.findings.texts import catalogue, finding_text, plain
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.measurement.control_review import listed as some_names
from photocal.measurement.image_facts import ABOVE_TAKE_OFF, ImageFacts
from photocal.measurement.maker_camera import HeadGroup, StatedCamera, group_cameras, stated_camera
from photocal.measurement.mark_frames import AS_STORED, parse_frame
from photocal.measurement.marks import named_after
from photocal.measurement.picture_tests import judge_cameras, judge_pictures, told_beside
from photocal.measurement.position_files import read_positions
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.vehicle import told_mounting
from photocal.project import ASKED, NAME
from photocal.run.camera_card import chosen_pictures
from photocal.run.folder_survey import ASSUMED_M, ControlFile, FolderContents, survey
from photocal.run.new_control import NewProject, StatedControl, settle
from photocal.run.renewed_project import answered_height, renewed, written_before

PICTURES = "pictures.csv"
# Positions of a receiver without corrections; their heights count from another surface than those of control.
CODE_LEVEL_M = (1.5, 1.5, 3.0)
# A camera of another c is another camera: this share of it, or so many sigmas of what the pictures say.
UNLIKE, FAR_SIGMAS = 0.1, 3.0
_ESTIMATE = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2")


def new_project(
    folder: Path, crs: str = "", height: str = "", marks: str = "", *, again: bool = False
) -> NewProject:
    """Write `project.toml` and, where control stands in another form, `control.csv` and `marks.csv`.

    crs, height, marks: what a person says of the control beside its file: system by code or name, kind of
        heights, size and turn of the pictures that its marks were made in.
    again: where they are there already, keep what a person has written, and add what was found since.
    raises InputNotFoundError: when the folder has neither pictures nor a log.
    raises OutputError: when one of the files is there already.
    """
    # Whoever has stated the kind of heights is not asked for it again.
    told = StatedControl(
        crs, height or (answered_height(folder) if again else ""), parse_frame(marks) if marks else None
    )
    seen = survey(folder, written_before(folder) if again else ())
    if not seen.pictures and not seen.logs:
        raise InputNotFoundError(
            "has neither pictures nor a flight log",
            "; ".join([*map(_found, seen.control), *seen.unread][:3]) or "name the folder of a flight",
            where=folder,
        )
    chosen = chosen_pictures(folder, seen.pictures, seen.events)
    seen.pictures, seen.events = chosen.pictures, list(chosen.events)
    pictures, facts, frame = chosen.folder, chosen.facts, chosen.frame
    control = _chosen(seen, facts)
    text = _Text(folder, seen, facts, pictures, control, told, frame)
    text.known += chosen.known
    text.missing += chosen.missing
    files = {NAME: "\n".join(text.lines()) + "\n"}
    if text.listed:
        files[PICTURES] = text.pictures_table()
    if control is not None and control.points is not None:
        files["control.csv"] = _points_table(text.control_points)
        if text.marks:
            columns = ("image", "point", "x", "y", "sx", "sy")
            rows = [[m.image, m.point, *(f"{v:.3f}" for v in (m.x, m.y, *m.sigma))] for m in text.marks]
            files["marks.csv"] = rows_text(columns, rows)
    # What is read stays as it is.
    sources = {found.file for found in (*seen.control, *seen.marks)}
    for name in [name for name in files if folder / name in sources]:
        files[f"read-{name}"] = files.pop(name)
        files[NAME] = files[NAME].replace(f'"{name}"', f'"read-{name}"')
    changes: tuple[str, ...] = ()
    there = [name for name in files if (folder / name).exists()]
    if again and NAME in there:
        moved = [name for name in files if name.endswith("marks.csv") and told.frame is not None]
        files, changes = renewed(folder, files, moved)
    elif there:
        remedy = f"photocal new {folder} --again keeps your entries and adds new findings"
        raise OutputError("exists already", remedy, where=folder / there[0])
    for name, content in files.items():
        with output_file(folder / name) as aside:
            aside.write_text(content, encoding="utf-8", newline="\n")
    made = text.control
    made.path, made.changes = folder / NAME, changes
    return made


def _found(control: ControlFile) -> str:
    points = 0 if control.points is None else len(control.points.names)
    pictures = len({mark.image for mark in control.marks})
    return f"{control.file.name} has {points} points and marks in {pictures} pictures: put them beside it"


def _paths(seen: FolderContents, pictures: Path | None) -> list[Path]:
    """Pictures of the folder, those of the one that is used last."""
    folders = sorted(seen.pictures, key=lambda where: where == pictures)
    return [where / image.name for where in folders for image in seen.pictures[where]]


def _chosen(seen: FolderContents, facts: Sequence[ImageFacts]) -> ControlFile | None:
    """The control of the folder: with marks in its pictures if there is such a file, else the first."""
    names = [image.name for image in facts]
    if not seen.control:
        return None

    def shown(control: ControlFile) -> int:
        """Count the marks in pictures that are there."""
        return sum(mark.image in names for mark in named_after(control.marks, names))

    def checks(control: ControlFile) -> int:
        """Count the check points."""
        return 0 if control.points is None else int(control.points.of_role("check").sum())

    best = max(seen.control, key=lambda control: (shown(control), checks(control)))
    if shown(best):
        return best
    tables = sorted(seen.marks, key=shown, reverse=True)
    points = (best.points or NO_POINTS).names
    # Programs leave the same marks in several files.
    others = [table.marks for table in tables[::-1]]
    every = {(m.image, m.point): m for marks in (best.marks, *others) for m in marks if m.point in points}
    return replace(best, marks=tuple(every.values()))


class _Text:
    """The lines of a project file, and what they find, miss and ask on the way."""

    def __init__(
        self,
        folder: Path,
        seen: FolderContents,
        facts: Sequence[ImageFacts],
        pictures: Path | None,
        given: ControlFile | None,
        told: StatedControl,
        frame: HeadGroup | None = None,
    ) -> None:
        self.folder, self.seen, self.facts, self.pictures, self.given = folder, seen, facts, pictures, given
        self.frame = frame
        self.cameras, self.member = group_cameras(facts)
        if frame is not None:
            head_of = {path.name: head for path, head in frame.head.items()}
            heads = [head_of[image.name] for image in facts]
            self.member = np.array([frame.heads.index(head) for head in heads], dtype=np.int64)
            names = [f"{facts[heads.index(head)].model}-{head}" for head in frame.heads]
            # As group_cameras writes them.
            self.cameras = tuple(re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-").lower() for name in names)
        # Where sizes do not tell cameras apart.
        self.listed = frame is not None or len({image.size_px for image in facts}) < len(self.cameras)
        self.placed = [image for image in facts if image.has_position]
        where = {path.name: path for path in _paths(seen, pictures)}
        self.control = settle(given, told, facts, where, flown=bool(seen.logs))
        self.known, self.missing = self.control.known, self.control.missing
        self.asked = self.control.asked
        self.crs, self.height = self.control.crs, self.control.height
        self.control_points, self.marks = self.control.points, self.control.marks

    def lines(self) -> Iterator[str]:
        """Give the whole file."""
        name = self.folder.resolve().name
        yield f"# Written by photocal new; docs/project-file.md has the keys. {ASKED!r}: to be filled in."
        yield "[project]"
        yield f"name = {_quoted(name)}"
        yield f"crs = {_quoted(self.crs or ASKED)}"
        yield f"height = {_quoted(self.height or ASKED)}{self._height_comment()}"
        yield 'output = "work"'
        yield from self._flight()
        if self.pictures is not None:
            yield from self._images()
            yield from self._cameras()
            yield from self._heads()
        yield from self._control()
        for left in self.seen.unread[:10]:
            self.missing.append(f"not used: {left}")

    def _height_comment(self) -> str:
        if self.control.height_is_assumed:
            return "  # assumed: not stated, and no position is compared with them"
        if self.crs == "local" or self.control_points.names:
            return ""
        kinds = {image.height_kind for image in self.placed}
        if kinds == {"ellipsoidal"}:
            return "  # as the pictures state"
        text = "pictures do not state the reference of their altitudes: heights may be wrong by the geoid"
        if any(image.altitude_kind == ABOVE_TAKE_OFF for image in self.placed):
            text = "pictures state their height above take-off only: all heights refer to that point"
        if "EGM96" in kinds:
            text = "pictures state heights above the geoid EGM96: ellipsoidal heights differ by its height"
        self.missing.append(text)
        return f"  # used as such: {text}"

    def _flight(self) -> Iterator[str]:
        seen = self.seen
        for path in seen.raw_logs:
            self.missing.append(f"{self._beside(path)} is a raw log: acquire import takes several into one")
        for path in seen.events:
            self.known.append(f"list of exposures {self._beside(path)}: with RINEX files, acquire import")
        if not seen.logs:
            return
        self.known.append(f"{len(seen.logs)} flight log(s)")
        yield "\n[flight]"
        yield f"logs = {json.dumps([self._beside(path) for path in seen.logs])}"
        yield "# base_position = [-22.7, -43.2, 30.0]   # latitude, longitude (deg), ellipsoidal height (m)"
        yield "\n[rig]  # body axes forward, right, down"
        offered = told_mounting(FlightLog(tuple(seen.logs)), "vehicle").camera_to_antenna_m
        if offered is not None:
            arm = ", ".join(f"{value:.3f}" for value in offered)
            self.known.append(f"antenna ({arm}) m forward, right, down of the body's origin (its parameters)")
            yield f"# [{arm}] by the vehicle's parameters if the camera sits at its origin (sigma 0.1 m)"
        yield f"camera_to_antenna_m = {_quoted(ASKED)}"
        yield "camera_to_antenna_sigma_m = [0.01, 0.01, 0.01]"
        yield "boresight_sigma_deg = [1.0, 1.0, 1.0]"
        yield "attitude_sigma_deg = [0.5, 0.5, 1.0]"
        yield "time_offset_sigma_s = 0.005"
        self.asked.append("camera_to_antenna_m in [rig]: from the projection centre to the antenna")

    def _images(self) -> Iterator[str]:
        count = len(self.facts)
        stated = sum(np.isfinite(image.position_sigma_m).all() for image in self.placed)
        others = [where for where in self.seen.pictures if where != self.pictures]
        if self.frame is not None:
            exposures = len(set(self.frame.exposure.values()))
            by = f"{len(self.frame.heads)} cameras on one frame, by {self.frame.by} of the pictures"
            self.known.append(f"{by}: {', '.join(self.frame.heads)}; {exposures} exposures")
            used = {path.parent for path in self.frame.head}
            others = [where for where in others if where not in used]
        comment = f"{count} pictures in {self._beside(self.pictures)}, {len(self.placed)} with a position"
        self.known.append(comment + (f", {stated} with its sigma" if stated else ""))
        self.known += told_beside(self.facts)
        judged = judge_cameras(self.facts, self.cameras, self.member.tolist())
        self.missing += [finding_text(finding, catalogue("en"), plain) for finding in judged]
        self.known += [
            f"{len(self.seen.pictures[w])} pictures in {self._beside(w)}: not used" for w in others
        ]
        yield f"\n[images]  # {comment}"
        yield f"folder = {_quoted(self._beside(self.pictures))}"
        if self.listed:
            yield f"pictures = {_quoted(PICTURES)}  # camera and exposure of each"
        events = self._events() if stated < count and not (self.seen.logs or self.seen.positions) else []
        tables = self.seen.positions or events
        if len(tables) == 1 and not self.seen.logs:
            comment = "  # with their sigmas" if stated else ""
            yield f"positions = {_quoted(self._beside(tables[0]))}{comment}"
        elif tables:
            names = ", ".join(map(self._beside, tables))
            self.missing.append(f"pictures have positions in {names}: name one as positions in [images]")
        yield 'lens = "unknown"  # chosen by the fit: brown-ideal, brown-observed, K4, B1; or "given"'
        if self.seen.logs or not self.placed or self.crs == "local":
            return
        if stated < len(self.placed):
            sigma = CODE_LEVEL_M if not self.marks else (*CODE_LEVEL_M[:2], OTHER_SURFACE_M)
            yield f"position_sigma_m = {list(sigma)}  # east, north, up: assumed, not stated by the pictures"

    def _events(self) -> list[Path]:
        """Lists of exposures that may be those of the pictures; says why others are not used."""
        names, usable = [image.name for image in self.facts], list[Path]()
        for path in self.seen.events:
            try:
                listed = list(map(read_positions(path, names), self.facts))
            except PhotocalError as refusal:
                self.missing.append(f"not used: {refusal}")
                continue
            apart = [found for found in judge_pictures(listed) if found.code == "table-beside-pictures"]
            told = [f"{self._beside(path)}: {finding_text(one, catalogue('en'), plain)}" for one in apart]
            known = sum(bool(np.isfinite(image.table_apart_m)) for image in listed)
            if any(2 * found.figures["n"] > known for found in apart):
                self.missing += [f"not used: {line}" for line in told]
                continue
            usable.append(path)
            self.missing += told
            if own := [image.name for image in listed if image.altitude_kind != "table"]:
                self.missing.append(
                    f"{self._beside(path)} has {len(listed) - len(own)} of the {len(listed)} pictures: "
                    f"positions of {some_names(own)} stay their own"
                )
        return usable

    def _cameras(self) -> Iterator[str]:
        known = {stated.size_px: stated for stated in (self.given.cameras if self.given is not None else ())}
        member, computed = self.member, self._computed()
        for k, name in enumerate(self.cameras):
            stated, taken = self._stated(k), int((member == k).sum())
            if stated.camera.size_px in known:
                source = f"of {self._beside(self.given.file)}" if self.given is not None else ""
                yield f"\n[[camera]]  # {taken} pictures; {source}"
                yield from _given_camera(replace(known[stated.camera.size_px], id=name))
                self.known.append(f"camera {name}: {source}")
                continue
            if stated.camera.size_px in computed and self._may_be(stated, computed[stated.camera.size_px]):
                file, own = computed[stated.camera.size_px]
                source = f"start values of {self._beside(file)}, as its program has estimated them"
                self.known.append(f"camera {name}: {taken} pictures, {source}")
                yield f"\n[[camera]]  # {taken} pictures; {source}"
                yield from _given_camera(replace(own, id=name))
                yield f"estimate = {json.dumps(list(_ESTIMATE))}"
                continue
            kind = "a guess" if stated.guessed else f"prior, {100 * stated.share:.2g} %"
            comment = f"c = {stated.camera.value('c'):.1f} px ({stated.source}; {kind})"
            self.known.append(f"camera {name}: {taken} pictures, {comment}")
            yield f"\n[[camera]]  # {taken} pictures; {comment}"
            yield from _camera(stated)
            if not stated.camera.rolling:
                yield 'shutter = "unknown"  # tested, and a readout is estimated when it rolls; or "global"'
            if stated.guessed:
                self.missing.append(f"the c of camera {name} is not stated: it is a guess, to be estimated")

    def _computed(self) -> dict[tuple[int, int], tuple[Path, Camera]]:
        """Cameras of .cam files by the size of their pictures, where both leave no doubt."""
        found: dict[tuple[int, int], list[tuple[Path, Camera]]] = {}
        for file, cameras in self.seen.cams.items():
            for own in cameras:
                found.setdefault(own.size_px, []).append((file, own))
        sizes = [self._stated(k).camera.size_px for k in range(len(self.cameras))]
        return {size: pairs[0] for size, pairs in found.items() if len(pairs) == 1 and sizes.count(size) == 1}

    def _may_be(self, stated: StatedCamera, computed: tuple[Path, Camera]) -> bool:
        """Whether a camera that was computed may be that of the pictures; says so where it is not."""
        file, own = computed
        theirs, ours = (camera.value("c") / camera.pitch[0] for camera in (own, stated.camera))
        if stated.guessed or abs(np.log(theirs / ours)) <= max(UNLIKE, FAR_SIGMAS * stated.share):
            return True
        self.missing.append(
            f"not used: {self._beside(file)} is of another camera: c is {theirs:.0f} px there, and "
            f"{ours:.0f} px as the pictures state ({stated.source})"
        )
        return False

    def _stated(self, camera: int) -> StatedCamera:
        """What the first picture of a camera says of it."""
        return stated_camera(self.cameras[camera], self.facts[int(np.argmax(self.member == camera))])

    def _heads(self) -> Iterator[str]:
        """Cameras on one frame: the pictures tell how they are turned, nothing how far they are apart."""
        if self.frame is None:
            return
        readouts = [self._stated(k).camera.value("readout") for k in range(len(self.cameras))]
        # By how much later a head may expose than the first, s: by pictures of a recorded head some 10 to 30
        # ms. Where readouts differ, so do their middles: heads begin together, or end together.
        later_s = 0.02
        # How far the cameras of a frame may be apart, m: the sigma of each coordinate.
        apart_m = 0.1
        for name, readout in zip(self.cameras[1:], readouts[1:], strict=True):
            half = (readout - readouts[0]) / 2
            yield "\n[[head]]  # rotated as the pictures state; rotation_deg and its sigma where it is known"
            yield f"camera = {_quoted(name)}"
            yield f"of = {_quoted(self.cameras[0])}"
            yield f"centre_m = [0.0, 0.0, 0.0]  # x right, y up, z backwards of {self.cameras[0]}: assumed"
            yield f"centre_sigma_m = {apart_m}"
            yield f"time_s = {half:.4g}  # middle of its readout, where those of all begin together: assumed"
            yield f"time_sigma_s = {np.hypot(later_s, half):.3g}"
        self.missing.append(
            f"the distance between the cameras is not stated: {apart_m} m assumed (centre_m in [[head]])"
        )

    def pictures_table(self) -> str:
        """Camera and exposure of each picture."""
        exposure = {} if self.frame is None else {p.name: e for p, e in self.frame.exposure.items()}
        rows = [
            [image.name, self.cameras[k], exposure.get(image.name, "")]
            for image, k in zip(self.facts, self.member, strict=True)
        ]
        return rows_text(("image", "camera", "exposure"), rows)

    def _control(self) -> Iterator[str]:
        given, points = self.given, self.control_points
        if given is None or not points.names:
            self.missing += [
                f"not used: {self._beside(table.file)} has marks, but no table has coordinates of its points"
                for table in self.seen.marks
            ]
            if not self.placed and not self.seen.logs:
                self.missing.append(
                    "neither positions nor control: the block will be relative, without scale. Mark both "
                    "ends of a known distance (points, marks and distances in [control])"
                )
            elif self.pictures is not None:
                self.missing.append("no control points: no independent check of the result")
            return
        images = len({mark.image for mark in self.marks})
        comment = f"{len(points.names)} points of {self._beside(given.file)}, "
        comment += f"{len(self.marks)} marks in {images} images"
        self.known.append(f"control: {comment}")
        yield f"\n[control]  # {comment}"
        yield 'points = "control.csv"' + (
            f"  # sigmas of {ASSUMED_M[0]} m, in height {ASSUMED_M[1]} m, are assumed"
            if given.assumed
            else ""
        )
        frame = self.control.frame
        yield 'marks = "marks.csv"' + (
            "" if frame == AS_STORED else f"  # made in pictures {frame.said()}: --marks {str(frame)!r}"
        )
        marked = len({mark.point for mark in self.marks})
        if not self.marks:
            self.missing.append("no marks of the control points: photocal mark project.toml")
        elif marked < policy.fewest_control and self.placed:
            self.missing.append(f"{marked} control points are marked; {policy.fewest_control} fix a block")
        if not points.of_role("check").any():
            self.missing.append("no check points: give some points of control.csv the role check")

    def _beside(self, path: Path | None) -> str:
        return "" if path is None else Path(os.path.relpath(path, self.folder)).as_posix()


def _camera(stated: StatedCamera) -> Iterator[str]:
    """Keys of a camera of the pictures: all is estimated that has a prior, or that rays determine."""
    prior = stated.prior_sigma()
    # Of other lenses those terms that their makers state.
    wanted = prior if stated.camera.lens.relative else {*_ESTIMATE, *prior}
    estimate = [name for name in PARAMETERS if name in wanted]
    yield from _given_camera(stated.camera)
    yield f"estimate = {json.dumps(estimate)}"
    yield "prior_sigma = { " + ", ".join(f"{n} = {s:.3g}" for n, s in prior.items()) + " }"
    if stated.guessed:
        yield "guessed = true"
    if stated.camera.stated_by:
        yield f"stated_by = {_quoted(stated.camera.stated_by)}"


def _given_camera(camera: Camera) -> Iterator[str]:
    """Keys of a camera that somebody else has calibrated: held."""
    values = {n: float(v) for n, v in zip(PARAMETERS, camera.values, strict=True) if v or n == "c"}
    yield f"id = {_quoted(camera.id)}"
    yield f"model = {_quoted(camera.model)}"
    yield f"unit = {_quoted(camera.unit)}"
    yield f"size_px = {list(camera.size_px)}"
    if camera.unit == "mm":
        yield f"pitch_mm = {list(camera.pitch)}"
    if camera.rolling:
        yield 'shutter = "rolling"  # its maker states how long a line takes'
    yield f"affinity = {_quoted(camera.affinity)}"
    yield "parameters = { " + ", ".join(f"{n} = {v!r}" for n, v in values.items()) + " }"


def _points_table(points: ObjectPoints) -> str:
    columns = zip(points.names, points.values, points.sigma, points.role, strict=True)
    rows = [
        [name, *(f"{v:.4f}" if np.isfinite(v) else "" for v in (*value, *sigma)), ROLES[role]]
        for name, value, sigma, role in columns
    ]
    return rows_text(("point", "X", "Y", "Z", "sX", "sY", "sZ", "role"), rows)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
