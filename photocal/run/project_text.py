"""The text of a project file: what a folder has, with comments, and what it lacks."""

import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.errors import PhotocalError
from photocal.base.files import rows_text
from photocal.base.policy import policy
from photocal.block.network import OTHER_SURFACE_M
from photocal.block.project import ASKED
from photocal.findings.digits import Number
from photocal.findings.texts import Catalogue, finding_text, plain
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.measurement.control_review import listed as some_names
from photocal.measurement.image_facts import ABOVE_TAKE_OFF, ImageFacts
from photocal.measurement.image_metadata import stated_places
from photocal.measurement.listed_positions import judge_order
from photocal.measurement.maker_camera import StatedCamera, group_cameras, stated_camera
from photocal.measurement.mark_frames import AS_STORED, MarkFrame
from photocal.measurement.marks import ControlMarks
from photocal.measurement.picture_tests import judge_cameras, judge_pictures, laser_and_temperature
from photocal.measurement.position_files import PlacesOfPictures, read_positions
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.vehicle import told_mounting
from photocal.run.camera_card import ChosenPictures
from photocal.run.control_files import ASSUMED_M
from photocal.run.folder_survey import FolderContents
from photocal.run.new_control import ELSEWHERE_M, NewProject, settle

PICTURES = "pictures.csv"
# Positions of a receiver without corrections; their heights refer to another surface than those of control.
CODE_LEVEL_M = (1.5, 1.5, 3.0)
# A camera of another c is another camera: this share of it, or so many sigmas of what the pictures say.
UNLIKE, FAR_SIGMAS = 0.1, 3.0
_ESTIMATE = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2")


class ProjectText:
    """The lines of a project file, and what they find, miss and ask on the way."""

    def __init__(
        self,
        folder: Path,
        seen: FolderContents,
        chosen: ChosenPictures,
        given: ControlMarks | None,
        control: NewProject,
        made_in: MarkFrame | None,
    ) -> None:
        self.folder, self.seen, self.given, self.control, self.say = folder, seen, given, control, control.say
        facts, pictures, frame = chosen.facts, chosen.folder, chosen.frame
        self.facts, self.pictures, self.frame = facts, pictures, frame
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
        stated = sum(np.isfinite(image.position_sigma_m).all() for image in self.placed)
        told_of, self.events = list[str](), list[Path]()
        placing: Sequence[ImageFacts] = facts
        if stated < len(facts) and not (seen.logs or seen.positions):
            self.events, placing = self._events(told_of)
        if len(seen.positions) == 1 and not seen.logs:
            told_of += self._own_places(seen.positions[0], facts)
        others = chosen.alike_elsewhere()
        settle(control, given, made_in, placing, chosen.place, flown=bool(seen.logs), others=others)
        self.known, self.missing = control.known, control.missing
        self.known += chosen.known
        self.missing += [*told_of, *chosen.missing]
        self.asked, self.crs, self.height = control.asked, control.crs, control.height
        self.control_points, self.marks = control.points, control.marks

    def lines(self) -> Iterator[str]:
        """Give the whole file."""
        name = self.folder.resolve().name
        yield f"# {self.say('new.wrote', asked=ASKED)}"
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
        if self.say.language != "en":
            yield "\n[certificate]"
            yield f'language = "{self.say.language}"  # {self.say("new.certificate_language")}'
            yield f'# form = "br-md"  # {self.say("new.certificate_form")}'
        for left in self.seen.unread[:10]:
            self.missing.append(self.say("new.not_used", text=self.say.refused(left)))

    def _height_comment(self) -> str:
        if self.control.height_is_assumed:
            return f"  # {self.say('new.height_assumed')}"
        if self.crs == "local" or self.control_points.names:
            return ""
        kinds = {image.height_kind for image in self.placed}
        if kinds == {"ellipsoidal"}:
            return f"  # {self.say('new.height_stated')}"
        text = self.say("new.height_unknown")
        if any(image.altitude_kind == ABOVE_TAKE_OFF for image in self.placed):
            text = self.say("new.height_above_start")
        if "EGM96" in kinds:
            text = self.say("new.height_egm96")
        self.missing.append(text)
        return f"  # {self.say('new.height_used', text=text)}"

    def _flight(self) -> Iterator[str]:
        seen, say = self.seen, self.say
        self.missing += [say("new.raw_log", file=self._beside(path)) for path in seen.raw_logs]
        self.known += [say("new.events", file=self._beside(path)) for path in seen.events]
        if not seen.logs:
            return
        self.known.append(say("new.log_found", n=len(seen.logs)))
        yield "\n[flight]"
        yield f"logs = {json.dumps([self._beside(path) for path in seen.logs])}"
        yield f"# base_position = [-22.7, -43.2, 30.0]   # {say('new.base_position')}"
        yield f"\n[rig]  # {say('new.body_axes')}"
        offered = told_mounting(FlightLog(tuple(seen.logs)), "vehicle").camera_to_antenna_m
        if offered is not None:
            arm = ", ".join(f"{value:.3f}" for value in offered)
            self.known.append(say("new.antenna", arm=arm))
            yield f"# [{arm}] {say('new.antenna_offered')}"
        yield f"camera_to_antenna_m = {_quoted(ASKED)}"
        yield "camera_to_antenna_sigma_m = [0.01, 0.01, 0.01]"
        yield "boresight_sigma_deg = [1.0, 1.0, 1.0]"
        yield "attitude_sigma_deg = [0.5, 0.5, 1.0]"
        yield "time_offset_sigma_s = 0.005"
        self.asked.append(say("new.antenna_asked"))

    def _images(self) -> Iterator[str]:
        count, say = len(self.facts), self.say
        stated = sum(np.isfinite(image.position_sigma_m).all() for image in self.placed)
        others = [where for where in self.seen.pictures if where != self.pictures]
        if self.frame is not None:
            exposures = len(set(self.frame.exposure.values()))
            heads, by = self.frame.heads, say(f"new.told.{self.frame.by}")
            named = {"heads": ", ".join(heads), "exposures": exposures}
            self.known.append(say("new.frame", n=len(heads), by=by, **named))
            used = {path.parent for path in self.frame.head}
            others = [where for where in others if where not in used]
        where = self._beside(self.pictures)
        # Pictures beside the project file: the folder's own name says more than a dot.
        named_so = self.folder.resolve().name if where == "." else where
        counted = {"n": count, "folder": named_so, "placed": len(self.placed)}
        comment = say("new.pictures", **counted)
        self.known.append(say("new.pictures_sigma", **counted, stated=stated) if stated else comment)
        self.known += laser_and_temperature(self.facts, say)
        judged = judge_cameras(self.facts, self.cameras, self.member.tolist())
        self.missing += [finding_text(finding, say, plain) for finding in judged]
        self.known += [
            say("new.pictures_left", n=len(self.seen.pictures[where]), folder=self._beside(where))
            for where in others
        ]
        yield f"\n[images]  # {comment}"
        yield f"folder = {_quoted(self._beside(self.pictures))}"
        if self.listed:
            yield f"pictures = {_quoted(PICTURES)}  # {say('new.pictures_listed')}"
        tables = self.seen.positions or self.events
        if len(tables) == 1 and not self.seen.logs:
            comment = f"  # {say('new.positions_sigmas')}" if stated else ""
            yield f"positions = {_quoted(self._beside(tables[0]))}{comment}"
        elif tables:
            names = ", ".join(map(self._beside, tables))
            self.missing.append(say("new.positions_several", files=names))
        yield f'lens = "unknown"  # {say("new.lens")}'
        if any(np.isfinite(image.laser_m) for image in self.facts):
            yield f'laser = "check"  # {say("new.laser_use")}'
        if self.seen.logs or not self.placed or self.crs == "local":
            return
        if stated < len(self.placed):
            sigma = CODE_LEVEL_M if not self.marks else (*CODE_LEVEL_M[:2], OTHER_SURFACE_M)
            yield f"position_sigma_m = {list(sigma)}  # {say('new.sigma_assumed')}"

    def _events(self, missing: list[str]) -> tuple[list[Path], Sequence[ImageFacts]]:
        """Lists of exposures that may be those of the pictures, and these with the positions of one alone.

        missing: what is said of others, and why they are not used.
        """
        names, usable, say = [image.name for image in self.facts], list[Path](), self.say
        placing: Sequence[ImageFacts] = self.facts
        for path in self.seen.events:
            try:
                given = read_positions(path, self.facts)
            except PhotocalError as refusal:
                missing.append(say("new.not_used", text=say.refused(str(refusal))))
                continue
            listed = list(map(given, self.facts))
            places = stated_places([image if image.altitude_kind == "table" else None for image in listed])
            apart = judge_order(names, places, stated_places(self.facts))
            apart += [found for found in judge_pictures(listed) if found.code == "table-beside-pictures"]
            told = [f"{self._beside(path)}: {finding_text(one, say, plain)}" for one in apart]
            known = sum(bool(np.isfinite(image.table_apart_m)) for image in listed)
            if any(found.severity == "grave" or 2 * found.figures["n"] > known for found in apart):
                missing += [say("new.not_used", text=line) for line in told]
                continue
            usable.append(path)
            placing = listed if len(usable) == 1 else self.facts
            missing += told
            missing += self._how_given(path, given)
            missing += self._own_places(path, listed)
        return usable, placing

    def _own_places(self, path: Path, listed: Sequence[ImageFacts]) -> Iterator[str]:
        """Name pictures that a table of positions does not have: they keep their own."""
        if own := [image.name for image in listed if image.altitude_kind != "table"]:
            counted = {"n": len(listed) - len(own), "all": len(listed), "names": some_names(own, self.say)}
            yield self.say("new.positions_own", file=self._beside(path), **counted)

    def _how_given(self, path: Path, given: PlacesOfPictures) -> Iterator[str]:
        """Say how the events of a list came to their pictures, where no name or number tells."""
        file, say = self._beside(path), self.say
        if given.by == "order":
            yield say("new.events_in_order", file=file)
        if given.by == "time":
            counted = {"n": len(given.places), "all": len(self.facts), "rival": given.rival}
            yield say("new.events_by_time", file=file, **counted)
        if given.left:
            yield say("new.events_left", file=file, n=len(given.left), lines=some_names(given.left, say))

    def _changed_sizes(self) -> None:
        """Name pictures that are not stored as their cameras wrote them."""
        for k, name in enumerate(self.cameras):
            own = [image for image, of in zip(self.facts, self.member, strict=True) if of == k]
            for key, found in (
                ("reduced", [image for image in own if image.reduction < 1.0]),
                ("cropped", [image for image in own if image.cropped]),
            ):
                if found:
                    size, full = ("{} x {}".format(*px) for px in (found[0].size_px, found[0].full_size_px))
                    self.missing.append(
                        self.say(f"new.{key}", n=len(found), camera=name, size=size, full=full)
                    )

    def _cameras(self) -> Iterator[str]:
        self._changed_sizes()
        known = {stated.size_px: stated for stated in (self.given.cameras if self.given is not None else ())}
        member, computed, say = self.member, self._computed(), self.say
        for k, name in enumerate(self.cameras):
            stated, taken = self._stated(k), int((member == k).sum())
            if stated.camera.size_px in known:
                of = self.given.file if self.given is not None else None
                source = say("new.camera_of", file=self._beside(of))
                yield f"\n[[camera]]  # {say('new.camera', n=taken, source=source)}"
                yield from _given_camera(replace(known[stated.camera.size_px], id=name), say)
                self.known.append(say("new.camera_known", name=name, source=source))
                continue
            if stated.camera.size_px in computed and self._may_be(stated, computed[stated.camera.size_px]):
                file, own = computed[stated.camera.size_px]
                source = say("new.camera_started", file=self._beside(file))
                self.known.append(say("new.camera_found", name=name, n=taken, source=source))
                yield f"\n[[camera]]  # {say('new.camera', n=taken, source=source)}"
                yield from _given_camera(replace(own, id=name), say)
                yield f"estimate = {json.dumps(list(_ESTIMATE))}"
                continue
            percent = f"{Number(100 * stated.share, say.mark):.2g}"
            kind = say("new.camera_guess") if stated.guessed else say("new.camera_prior", percent=percent)
            told = {"c": say.fixed(stated.camera.value("c"), 1), "source": self._source(stated)}
            comment = say("new.camera_c", **told, kind=kind)
            self.known.append(say("new.camera_found", name=name, n=taken, source=comment))
            yield f"\n[[camera]]  # {say('new.camera', n=taken, source=comment)}"
            yield from _estimated_camera(stated, say)
            if not stated.camera.rolling:
                yield f'shutter = "unknown"  # {say("new.shutter")}'
            if stated.guessed:
                self.missing.append(say("new.camera_guessed", name=name))

    def _source(self, stated: StatedCamera) -> str:
        """Where a camera comes from, in words."""
        return self.say.stored(stated.source)

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
        figures = {"theirs": f"{theirs:.0f}", "ours": f"{ours:.0f}", "source": self._source(stated)}
        other = self.say("new.camera_other", file=self._beside(file), **figures)
        self.missing.append(self.say("new.not_used", text=other))
        return False

    def _stated(self, camera: int) -> StatedCamera:
        """What the first picture of a camera says of it."""
        return stated_camera(self.cameras[camera], self.facts[int(np.argmax(self.member == camera))])

    def _heads(self) -> Iterator[str]:
        """Cameras on one frame: the pictures tell how they are turned, nothing how far they are apart."""
        if self.frame is None:
            return
        say = self.say
        readouts = [self._stated(k).camera.value("readout") for k in range(len(self.cameras))]
        # By how much later a head may expose than the first, s: by pictures of a recorded head some 10 to 30
        # ms. Where readouts differ, so do their middles: heads begin together, or end together.
        later_s = 0.02
        # How far the cameras of a frame may be apart, m: the sigma of each coordinate.
        apart_m = 0.1
        for name, readout in zip(self.cameras[1:], readouts[1:], strict=True):
            half = (readout - readouts[0]) / 2
            yield f"\n[[head]]  # {say('new.head_rotation')}"
            yield f"camera = {_quoted(name)}"
            yield f"of = {_quoted(self.cameras[0])}"
            yield f"centre_m = [0.0, 0.0, 0.0]  # {say('new.head_centre', camera=self.cameras[0])}"
            yield f"centre_sigma_m = {apart_m}"
            yield f"time_s = {half:.4g}  # {say('new.head_time')}"
            yield f"time_sigma_s = {np.hypot(later_s, half):.3g}"
        self.missing.append(say("new.head_apart", apart=say.as_given(apart_m)))

    def pictures_table(self) -> str:
        """Camera and exposure of each picture."""
        exposure = {} if self.frame is None else {p.name: e for p, e in self.frame.exposure.items()}
        rows = [
            [image.name, self.cameras[k], exposure.get(image.name, "")]
            for image, k in zip(self.facts, self.member, strict=True)
        ]
        return rows_text(("image", "camera", "exposure"), rows)

    def _control(self) -> Iterator[str]:
        given, points, say = self.given, self.control_points, self.say
        if given is None or not points.names:
            self.missing += [
                say("new.not_used", text=say("new.marks_alone", file=self._beside(table.file)))
                for table in self.seen.marks
            ]
            if not self.placed and not self.seen.logs:
                self.missing.append(say("new.no_scale"))
            elif self.pictures is not None:
                self.missing.append(say("new.no_control"))
            return
        images = len({mark.image for mark in self.marks})
        counted = {"points": len(points.names), "marks": len(self.marks), "images": images}
        comment = say("new.control", **counted, file=self._beside(given.file))
        self.known.append(say("new.control_known", text=comment))
        self._other_control(given)
        yield f"\n[control]  # {comment}; {say('new.control_copied')}"
        sigma = dict(zip(("plane", "height"), map(say.as_given, ASSUMED_M), strict=True))
        yield 'points = "control.csv"' + (f"  # {say('new.control_sigma', **sigma)}" if given.assumed else "")
        frame = self.control.frame
        made_in = say("new.marks_frame", frame=frame.said(say), option=str(frame))
        yield 'marks = "marks.csv"' + ("" if frame == AS_STORED else f"  # {made_in}")
        marked = len({mark.point for mark in self.marks})
        if not self.marks:
            self.missing.append(say("new.no_marks"))
        elif marked < policy.fewest_control and self.placed:
            self.missing.append(say("new.few_marked", n=marked, fewest=policy.fewest_control))
        if not points.of_role("check").any():
            self.missing.append(say("new.no_checks"))
        elif not points.of_role("control").any():
            self.missing.append(say("new.only_checks"))

    def _other_control(self, given: ControlMarks) -> None:
        """Name other files of control that say something else than the one that is used."""
        own = dict(zip(given.points.names, given.points.values, strict=True))
        for other in self.seen.control:
            listed = dict(zip(other.points.names, other.points.values, strict=True))
            away = {name: np.abs(place - own[name]).max() for name, place in listed.items() if name in own}
            # Millimetres are of rounding.
            same_m = 0.002
            unlike = [name for name in listed if not away.get(name, np.inf) < same_m]
            named = {"file": self._beside(other.file), "used": self._beside(given.file)}
            if other.file in given.beside:
                self.known.append(self.say("new.control_joined", n=len(listed), **named))
            if other.file in (given.file, *given.beside) or not unlike:
                continue
            if away and np.median(list(away.values())) < ELSEWHERE_M:
                told = some_names(unlike, self.say)
                self.control.doubtful.append(self.say("new.other_control", names=told, **named))
            else:
                self.known.append(self.say("new.control_left", **named))

    def _beside(self, path: Path | None) -> str:
        return "" if path is None else Path(os.path.relpath(path, self.folder)).as_posix()


def _estimated_camera(stated: StatedCamera, say: Catalogue) -> Iterator[str]:
    """Keys of a camera of the pictures: all is estimated that has a prior, or that rays determine."""
    prior = stated.prior_sigma()
    # Of other lenses those terms that their makers state.
    wanted = prior if stated.camera.lens.relative else {*_ESTIMATE, *prior}
    estimate = [name for name in PARAMETERS if name in wanted]
    yield from _given_camera(stated.camera, say)
    yield f"estimate = {json.dumps(estimate)}"
    yield "prior_sigma = { " + ", ".join(f"{n} = {s:.3g}" for n, s in prior.items()) + " }"
    if stated.guessed:
        yield "guessed = true"
    if stated.camera.stated_by:
        yield f"stated_by = {_quoted(stated.camera.stated_by)}"


def _given_camera(camera: Camera, say: Catalogue) -> Iterator[str]:
    """Keys of a camera that somebody else has calibrated: held."""
    values = {n: float(v) for n, v in zip(PARAMETERS, camera.values, strict=True) if v or n == "c"}
    yield f"id = {_quoted(camera.id)}"
    yield f"model = {_quoted(camera.model)}"
    yield f"unit = {_quoted(camera.unit)}"
    yield f"size_px = {list(camera.size_px)}"
    if camera.unit == "mm":
        yield f"pitch_mm = {list(camera.pitch)}"
    if camera.rolling:
        yield f'shutter = "rolling"  # {say("new.shutter_rolling")}'
    yield f"affinity = {_quoted(camera.affinity)}"
    yield "parameters = { " + ", ".join(f"{n} = {v!r}" for n, v in values.items()) + " }"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
