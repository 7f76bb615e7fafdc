"""One share and one remaining time of a run, by a clock that the test turns."""

from __future__ import annotations

import io
import json
import math
import statistics
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from photocal.base.progress import Standing, followed, quiet
from photocal.base.progress_bars import STARTING, one_bar, while_starting
from photocal.commands.project import progress_words
from photocal.findings.texts import catalogue
from photocal.measurement.image_pairs import ALL_UP_TO, NEAREST, among_nearest, select_pairs
from photocal.run.course import (
    CODED,
    CONTROL,
    PLAIN,
    RAYS_OF_A_PICTURE,
    Course,
    Workload,
    about_rays,
    expected,
    into,
    usual_pieces,
    workload,
)


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_a_stage_takes_what_it_took_last_time() -> None:
    nothing = workload(0, 0.0, 0.0)
    assert expected({"block": 3.0, "analysis": 0.0}, ("block", "analysis"), nothing, {})["block"] == 3.0
    much = workload(100, 12.0, 20e3)
    usual = expected({}, ("measurements", "another"), much, usual_pieces(much))
    assert usual["measurements"] > usual["another"] > 0.0
    assert expected({}, ("analysis",), workload(0, 0.0, 1e6), {})["analysis"] > 3.0 * usual["another"]


def test_rays_are_told_by_the_size_of_their_file(tmp_path: Path) -> None:
    assert about_rays(tmp_path) == 0.0
    rows = [f"IMG_{k % 40:04},ti{k},{k * 0.6180339887 % 4000},{k * 0.3819660113 % 3000}" for k in range(1000)]
    (tmp_path / "observations.csv").write_text("\n".join(["image,point,x,y", *rows]) + "\n")
    assert about_rays(tmp_path) == pytest.approx(1000.0, rel=0.2)


def test_pairs_are_about_as_many_as_are_matched() -> None:
    """Pictures of one place, of which each has so many neighbours at most."""
    for count in (10, 40, 200):
        places = np.random.default_rng(count).uniform(0.0, 100.0, (count, 2))
        pairs, _ = select_pairs((places, np.full(count, 1e3)), count)
        if count > ALL_UP_TO:
            pairs = pairs[among_nearest(places, pairs, NEAREST)]
        assert 0.6 < workload(count, 12.0, 0.0)[2] / len(pairs) <= 1.0


def test_an_overdue_stage_tells_of_those_after_it() -> None:
    clock = Clock()
    for seen_s, analysis_s in ((0.0, 50.0 * 2.0**0.5), (1e-3, 100.0)):
        course = Course({"calibration": 10.0, "analysis": 50.0}, quiet, clock, seen_s)
        course.begin("calibration")
        clock.now += 20.0
        # Twice as long already: the analysis will not take 50 s. Half of it where 10 s were a guess.
        assert course.standing().left_s == pytest.approx(analysis_s, rel=0.1)


# Recorded with nothing beside, nothing kept from before: pictures, their megapixels, seconds of each piece of
# measuring and of the analysis with the calibration, by an earlier version. What is usual was fitted to
# simulated flights of 42 and 308 pictures; these stood apart, but for the share of the analysis.
RECORDED = {
    "caliterra": ((12, 12.0), (6.0, 1.9, 4.2, 4.7, 0.9, 2.7), 1.3),
    "lewis": ((10, 12.0), (5.3, 1.6, 2.4, 2.1, 0.3, 0.8), 0.4),
    "brighton": ((18, 9.0), (8.7, 2.4, 4.5, 4.2, 2.5, 16.0), 16.0),
    "kite": ((16, 4.0), (8.2, 3.9, 9.1, 5.9, 0.7, 3.6), 4.0),
    "sequoia": ((4, 16.0), (2.8, 0.2, 2.8, 0.9, 0.6, 0.8), 7.0),
}
PIECES = (
    "detecting features",
    "matching pairs of images",
    "orienting the pictures",
    "matching tie points precisely",
    "adjusting the tie points",
    "adjusting the cameras",
)
# Nobody knows how much they have to do; the last has three steps.
UNCOUNTED = PIECES[2], PIECES[4]
# None of these has control.
ABSENT = (CODED, PLAIN, CONTROL)


def work_of(pictures: int, megapixels: float) -> Workload:
    """Work of a flight with as many rays as pictures usually have."""
    return workload(pictures, megapixels, RAYS_OF_A_PICTURE * pictures)


# Of a flight of twelve pictures with 12 megapixels.
USUAL = usual_pieces(work_of(12, 12.0), ABSENT)
# How many times as long everything takes on the computer at work.
PACES = (0.5, 1.0, 3.0)


def told(name: str, pace: float, titles: tuple[str, ...] = PIECES) -> tuple[list[float], list[float]]:
    """Error of the remaining time (log of told by real) and share done, second by second."""
    (pictures, megapixels), recorded, analysis_s = RECORDED[name]
    size = work_of(pictures, megapixels)
    usual = usual_pieces(size, ABSENT)
    clock, errors, shares = Clock(), list[float](), list[float]()
    seconds = [pace * amount for amount in recorded]
    ahead = expected({}, ("measurements", "analysis"), size, usual)
    left = sum(seconds) + pace * analysis_s
    course = Course(ahead, quiet, clock, pieces=usual)
    course.begin("measurements")
    for title, amount in zip(titles, seconds, strict=True):
        total = None if title in UNCOUNTED else 3.0 if title == PIECES[-1] else amount
        with course.progress(title, total) as done:
            # Ten times a second: some last less than one.
            ticks = int(amount * 10)
            for tick in range(1, ticks + 1):
                clock.now += 0.1
                left -= 0.1
                done(float(tick * 3 // ticks - (tick - 1) * 3 // ticks) if total == 3.0 else 0.1)
                now = course.standing()
                errors.append(abs(math.log(now.left_s / left)))
                shares.append(now.share)
    return errors, shares


@pytest.mark.parametrize("name", RECORDED)
def test_pieces_of_a_stage_tell_more_of_its_time_than_the_piece_at_work(name: str) -> None:
    """The mean error on computers of other paces, beside that of a stage whose pieces nobody knows."""
    known, unknown = list[float](), list[float]()
    for pace in PACES:
        errors, shares = told(name, pace)
        assert shares == sorted(shares)
        known.append(statistics.mean(errors))
        unknown.append(statistics.mean(told(name, pace, ("1", "2", "3", "4", "5", "6"))[0]))
    assert statistics.mean(known) < statistics.mean(unknown)


@pytest.mark.parametrize("name", RECORDED)
def test_the_first_second_of_a_flight_promises_half_to_twice_its_time(name: str) -> None:
    size, seconds, _ = RECORDED[name]
    promised = sum(usual_pieces(work_of(*size), ABSENT)["measurements"].values())
    assert 0.5 < promised / sum(seconds) < 2.0


def with_features(seconds: float) -> tuple[Clock, Course]:
    """A stage of 100 s whose features took so long."""
    clock = Clock()
    course = Course({"measurements": 100.0}, quiet, clock, pieces=USUAL)
    course.begin("measurements")
    with course.progress(PIECES[0], 30) as done:
        clock.now += seconds
        done(30)
    return clock, course


@pytest.mark.parametrize("kept", [0, 9, 20])
def test_features_that_an_ended_run_left_are_not_counted_again(kept: int) -> None:
    """A run that is begun again has less before it, and learns the pace from what it does itself."""
    clock, pictures, pace = Clock(), 30, 2.0
    counted = {PIECES[0]: float(pictures)}
    course = Course({"measurements": 100.0}, quiet, clock, pieces=USUAL, counted=counted)
    course.begin("measurements")
    share_of = {
        name: seconds / sum(USUAL["measurements"].values()) for name, seconds in USUAL["measurements"].items()
    }
    with course.progress(PIECES[0], pictures - kept) as done:
        clock.now += pace * 100.0 * share_of[PIECES[0]] * (1 - kept / pictures)
        done(pictures - kept)
    left_s = pace * 100.0 * (1.0 - share_of[PIECES[0]])
    # Remaining times are to be right within 30 %.
    assert 0.7 * left_s < course.standing().left_s < 1.3 * left_s


def test_what_the_cameras_took_tells_of_stages_that_adjust_them_again() -> None:
    """As far as these are to be made, and while the cameras are adjusted, by the steps that are done."""
    clock = Clock()
    course = Course({"measurements": 30.0, "calibration": 1.0, "analysis": 1.0}, quiet, clock, pieces=USUAL)
    course.revise({"calibration": 0.0})
    course.begin("measurements")
    with course.progress(PIECES[-1], 3) as done:
        clock.now += 20.0
        done(1)
        while_at_work = course.standing().left_s
        clock.now += 40.0
        done(2)
    course.end(kept=False)
    after = course.standing().left_s
    assert while_at_work > 40.0 + 0.8 * 60.0
    assert 0.8 * 60.0 < after < 0.8 * 60.0 + 10.0
    course.begin("analysis")
    assert course.standing().left_s > 0.8 * 60.0


def test_the_time_left_falls_while_a_piece_without_an_amount_is_at_work() -> None:
    clock, course = with_features(30.0)
    before = course.standing().left_s
    with course.progress(PIECES[2], None):
        clock.now += 5.0
        assert course.standing().left_s == pytest.approx(before - 5.0)


def test_pieces_that_an_earlier_run_left_promise_no_quick_end() -> None:
    """Features that are kept are there at once; the pieces after them are not."""
    left = with_features(0.5)[1].standing().left_s
    # What features take of all pieces of the usual flight is not among it any more.
    pieces = USUAL["measurements"]
    rest = 100.0 * (1.0 - pieces[PIECES[0]] / sum(pieces.values()))
    assert left == pytest.approx(rest, rel=0.02)


def test_a_piece_that_few_flights_have_leaves_the_time_as_it_was() -> None:
    clock = Clock()
    course = Course({"measurements": 15.0, "analysis": 5.0}, quiet, clock, pieces=USUAL)
    course.begin("measurements")
    with course.progress(PIECES[0], 30) as done:
        clock.now += 30.0
        done(30)
    before = course.standing().left_s
    with course.progress(PLAIN, 40):
        assert course.standing().left_s == pytest.approx(before)


def test_what_has_not_begun_is_expected_otherwise() -> None:
    clock = Clock()
    course = Course({"block": 10.0, "analysis": 50.0, "certificate": 5.0}, quiet, clock)
    course.begin("block")
    clock.now += 10.0
    course.end(kept=False)
    course.revise({"block": 99.0, "analysis": 500.0, "certificate": 0.0})
    assert course.standing().left_s == pytest.approx(500.0)


def test_time_left_is_that_of_all_stages_at_the_pace_of_this_machine() -> None:
    clock = Clock()
    course = Course({"measurements": 100.0, "block": 10.0, "certificate": 90.0}, quiet, clock, pieces=USUAL)
    course.begin("measurements")
    assert course.standing().left_s == pytest.approx(200.0)
    with course.progress("matching", 50) as done:
        # Half as fast as expected: the piece of work itself tells.
        clock.now += 100.0
        done(25)
        now = course.standing()
        assert (now.stage, now.title, now.piece_share) == ("measurements", "matching", 0.5)
        assert now.piece_left_s == pytest.approx(100.0)
        assert now.left_s == pytest.approx(100.0 + 100.0)
        clock.now += 100.0
        done(25)
    course.end(kept=False)
    course.begin("block")
    # What took 200 s and not 100 foretells the others: half of it is held against what was expected.
    assert course.standing().left_s == pytest.approx(100.0 * 2.0**0.5, rel=0.05)
    course.end(kept=True)
    course.begin("certificate")
    clock.now += 500.0
    late = course.standing()
    assert late.left_s == pytest.approx(50.0)
    assert 0.9 < late.share < 1.0
    course.end(kept=False)
    assert course.standing().left_s == 0.0
    assert course.standing().share == 1.0


def test_it_is_told_while_the_work_says_nothing(tmp_path: Path) -> None:
    course, seen, enough = Course({"ppk": 60.0}, quiet), list[float](), threading.Event()

    def listen(now: Standing) -> None:
        seen.append(now.elapsed_s)
        if len(seen) == 3:
            enough.set()

    file = tmp_path / "progress.json"
    course.begin("ppk")
    with followed(course.standing, into(file), listen):
        assert enough.wait(30.0)
    content = json.loads(file.read_text())
    assert content["stage"] == "ppk"
    assert 0.0 < content["run"]["left_s"] <= 60.0
    assert {"title", "share", "left_s", "elapsed_s"} < set(content)


def test_a_listener_that_fails_ends_no_run() -> None:
    def full(_: Standing) -> None:
        raise OSError(28, "No space left on device")

    with followed(Course({}, quiet).standing, full):
        pass


@pytest.mark.parametrize("as_json", [True, False])
def test_lines_into_a_file(as_json: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    with one_bar(as_json)() as show:
        for second in range(21):
            show(Standing("analysis", "images", 0.5, 2.0, 2.0, second / 40.0, 40.0 - second, float(second)))
    lines = stream.getvalue().splitlines()
    if as_json:
        steps = [json.loads(line)["progress"] for line in lines]
        assert [step["elapsed_s"] for step in steps] == [float(t) for t in range(21)]
        last = {"stage": "analysis", "title": "images", "share": 0.5, "left_s": 20.0, "elapsed_s": 20.0}
        assert steps[-1] == last
    else:
        assert len(lines) == 3
        assert lines[-1] == "analysis: images: 50% of the run, 20 s left"


@pytest.mark.parametrize(("as_json", "seconds"), [(True, 2.5), (True, 0.0), (False, 2.5)])
def test_a_program_hears_of_a_run_before_that_knows_what_it_has_to_do(
    as_json: bool, seconds: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where it takes long to start. A file gets no line that says nothing."""
    with while_starting(one_bar(as_json)):
        time.sleep(seconds)
    lines = capsys.readouterr().err.splitlines()
    if not (as_json and seconds):
        assert not lines
        return
    told_now = json.loads(lines[0])["progress"]
    assert (told_now["title"], told_now["left_s"]) == (STARTING, None)
    assert 0.5 < told_now["elapsed_s"] < seconds


@pytest.mark.parametrize(
    ("stage", "title", "line"),
    [
        ("", "", "0% of the run, 40 s left"),
        ("analysis", "", "analysis: 0% of the run, 40 s left"),
        ("analysis", "analysis", "analysis: 0% of the run, 40 s left"),
    ],
)
def test_a_name_stands_once(stage: str, title: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    with one_bar()() as show:
        show(Standing(stage, title, None, None, 0.0, 0.0, 40.0, 0.0))
    assert capsys.readouterr().err == line + "\n"


def test_progress_speaks_the_language_of_the_person(capsys: pytest.CaptureFixture[str]) -> None:
    """Stages keep the names by which `--again` knows them."""
    with one_bar(words=progress_words(catalogue("pt-BR")))() as show:
        show(Standing("measurements", "matching pairs of images", None, None, 0.0, 0.36, 53.0, 0.0))
    line = "measurements: associando pares de imagens: 36% do processamento, faltam 53 s"
    assert capsys.readouterr().err == line + "\n"
    assert progress_words(catalogue("en")) == {}


def test_every_work_of_a_run_has_its_title_in_portuguese() -> None:
    """Titles that are not in the window's texts would stay English."""
    known = progress_words(catalogue("pt-BR"))
    titles = {name for pieces in usual_pieces(work_of(1, 1.0)).values() for name in pieces}
    assert titles
    assert titles <= known.keys()
