"""docs/guide: its commands run on a simulated flight, its warnings are those of the program.

They are those of the wheel, installed into an empty environment away from the sources.
"""

from __future__ import annotations

import ast
import glob
import json
import re
import shlex
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from acquire.simulate.world.configuration import FLIGHTS
from photocal.block.mounting import BODY_AXES
from photocal.block.project import RigSettings
from photocal.findings.texts import catalogue
from photocal.hypotheses.faults import FAULTS
from tests.conftest import needs_engine
from tests.installed import surroundings

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "docs" / "guide"
# Where findings are made that `photocal run` tells.
FOUND_IN = ("photocal/navigation", "photocal/measurement", "photocal/analysis/georeferencing", "photocal/run")
FOUND_BY = ("photocal/analysis/accuracy/ground_points.py", "photocal/hypotheses/table.py")


def blocks(chapter: str, language: str) -> list[str]:
    text = (GUIDE / f"{chapter}.md").read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


class Window:
    """A command in a window of its own."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def wait_for(self, word: str) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if word in line:
                return
        raise AssertionError(f"it ended before it said {word!r}")

    def interrupt(self) -> None:
        self._process.send_signal(signal.SIGINT)
        _, said = self._process.communicate(timeout=300)
        assert self._process.returncode == 0, said

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


class Desk:
    """The windows of somebody who follows the guide."""

    def __init__(self, folder: Path, python: Path) -> None:
        self.folder = folder
        self._python = str(python)
        self._surroundings = surroundings(folder / "cache")
        self.said: dict[str, str] = {}
        self.windows: dict[str, Window] = {}

    def follow_all(self, chapter: str) -> None:
        for line in _lines(chapter):
            self.follow(line)

    def follow(self, line: str) -> None:
        words = shlex.split(line, comments=True)
        words = [w for word in words for w in (sorted(glob.glob(word, root_dir=self.folder)) or [word])]  # noqa: PTH207
        name = " ".join(words[:2])
        if "in a window of its own" in line:
            process = subprocess.Popen(
                self._program(words),
                cwd=self.folder,
                env=self._surroundings,
                stderr=subprocess.PIPE,
                text=True,
            )
            self.windows[name] = Window(process)
            return
        done = self.run(words)
        self.said[name] = done.stdout + done.stderr
        assert done.returncode == 0, f"{line}\n{done.stderr}"

    def run(self, words: list[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self._program(words),
            cwd=self.folder,
            env=self._surroundings,
            capture_output=True,
            text=True,
            check=False,
        )

    def _program(self, words: list[str]) -> list[str]:
        return [self._python, "-m", *words] if words[0] in ("acquire", "photocal") else words


@pytest.fixture(scope="module")
def started(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    """The practice of the first page, and the chapter on planning."""
    folder = tmp_path_factory.mktemp("guide")
    # Fewer points than for practice: the evening of the test is shorter. A file goes before a known flight.
    plan = (FLIGHTS / "small.toml").read_text(encoding="utf-8")
    (folder / "small").write_text(plan.replace("ties = 150", "ties = 60"), encoding="utf-8")
    desk = Desk(folder, installed)
    try:
        desk.follow_all("README")
        desk.folder = folder / "practice" / "site"
        (desk.folder / "area.csv").write_text(blocks("planning", "csv")[0])
        desk.follow_all("planning")
        yield desk
    finally:
        for window in desk.windows.values():
            window.close()


@pytest.fixture(scope="module")
def recorded(started: Desk) -> Desk:
    """The chapter on the field: the devices fly as soon as the recorder speaks to them."""
    settings = started.folder / "record.toml"
    limit = time.monotonic() + 300
    while not settings.exists():
        assert time.monotonic() < limit
        time.sleep(0.05)
    forms, check, record, monitor, *rest = _lines("field")
    started.follow(forms)
    # The simulated devices are silent before they are recorded: the check has a test of its own.
    assert check.startswith("acquire check")
    started.follow(record)
    started.windows["acquire record"].wait_for("recording to")
    started.windows["acquire simulate"].wait_for("flown")
    started.follow(monitor)
    started.windows["acquire record"].interrupt()
    for line in rest:
        started.follow(line)
    return started


@pytest.fixture(scope="module")
def processed(recorded: Desk) -> Desk:
    """The chapter on processing."""
    needs_engine()
    recorded.follow_all("processing")
    return recorded


@pytest.fixture(scope="module")
def certified(processed: Desk) -> Desk:
    """The chapter on the certificate."""
    processed.follow_all("certificate")
    return processed


def _lines(chapter: str) -> list[str]:
    return [line for block in blocks(chapter, "sh") for line in block.splitlines()]


def test_a_card_becomes_a_certificate(installed: Path, tmp_path: Path) -> None:
    desk = Desk(tmp_path, installed)
    desk.follow_all("first")
    work = tmp_path / "practice" / "site" / "work"
    assert (work / "certificate" / "certificate.pdf").read_bytes().startswith(b"%PDF")
    truth = json.loads((tmp_path / "practice" / "truth" / "truth.json").read_text())
    (camera,) = json.loads((work / "calibration" / "result.json").read_text())["cameras"].values()
    found = camera["parameters"]["c"]
    assert abs(found["value"] - truth["camera"]["px"]["c"]) < 3 * found["sigma"]


def test_the_flight_is_recorded_whole(recorded: Desk) -> None:
    said = recorded.said["acquire info"]
    verdict = re.search(
        r"```text\n(verdict: complete.*?)```", (GUIDE / "field.md").read_text("utf-8"), re.DOTALL
    )
    assert verdict is not None
    # Here the devices fly faster than in the field, by how much the machine decides.
    in_field, here = (re.findall(r"([\d.]+) Hz", text) for text in (verdict[1], said.partition("can be")[0]))
    assert len(here) == len(in_field) == 2
    base, rover = (float(now) / float(then) for now, then in zip(here, in_field, strict=True))
    assert rover == pytest.approx(base, rel=0.05)
    told = re.sub(r"[\d.]+ Hz", "Hz", said)
    assert told.startswith(re.sub(r"[\d.]+ Hz", "Hz", verdict[1]))
    assert re.findall(r"(\d+) bytes belong to no valid frame", said) == ["0", "0", "0"]


def test_the_run_finds_the_truth(processed: Desk) -> None:
    said = processed.said["photocal run"]
    assert re.search(r"^PPK +(9[5-9]|100)\.\d % of", said, re.MULTILINE)
    assert "10 of 10 images matched" in said
    assert re.search(r"^verdict +This block is fit for mapping", said, re.MULTILINE)
    truth = json.loads((processed.folder.parent / "truth" / "truth.json").read_text())
    result = json.loads((processed.folder / "work" / "calibration" / "result.json").read_text())
    found = result["cameras"]["SIM-0"]["parameters"]["c"]
    assert abs(found["value"] - truth["camera"]["mm"]["c"]) < 3 * found["sigma"]


def test_every_line_of_the_screen_is_explained(processed: Desk) -> None:
    text = (GUIDE / "processing.md").read_text(encoding="utf-8")
    rows = " ".join(re.findall(r"^\| ([^|]+) \|", text, re.MULTILINE))
    shown = re.findall(r"^([A-Za-z][A-Za-z ]*?)(?: SIM-0)?  +", processed.said["photocal run"], re.MULTILINE)
    for word in {word.strip() for word in shown} - {"certificate"}:
        assert word in rows, word


def test_plan_targets_and_products_are_there(certified: Desk) -> None:
    names = {"plan.json", "flight.plan", "flight.waypoints", "plan.geojson", "exposures.csv"}
    assert {path.name for path in (certified.folder / "plan").iterdir()} == names
    assert "* " not in certified.said["photocal plan"], "the plan of the guide has nothing against it"
    assert (certified.folder / "targets.pdf").read_bytes().startswith(b"%PDF")
    written = {path.name for path in (certified.folder / "work" / "certificate").iterdir()}
    assert {"certificate.html", "certificate.pdf", "certificate.json", "inputs"} <= written
    assert (certified.folder / "check" / "report.md").is_file()
    assert any((certified.folder / "for-client").iterdir())


def test_the_certificate_is_verified_and_a_changed_digit_named(certified: Desk) -> None:
    assert "reproducible" in certified.said["photocal verify"]
    points = certified.folder / "work" / "certificate" / "inputs" / "points.csv"
    points.write_text(points.read_text().replace("control", "check", 1))
    done = certified.run(["photocal", "verify", "work/certificate"])
    assert done.returncode != 0
    assert "points.csv" in done.stderr


def test_a_check_of_devices_that_are_silent_names_them(installed: Path, tmp_path: Path) -> None:
    """What `acquire check` of the guide says when the recorder has set up nothing yet."""
    (tmp_path / "empty.ubx").touch()
    link = '[[link]]\nname = "rover"\nprotocol = "ubx"\nurl = "file:empty.ubx"\n'
    link += '[link.ublox]\nport = "usb"\nrate_ms = 200\n'
    (tmp_path / "record.toml").write_text(f'[recording]\noutput = "logs"\n{link}')
    check = next(line for line in _lines("field") if line.startswith("acquire check"))
    words = shlex.split(check.replace("--seconds 2", "--seconds 0.3"))
    done = Desk(tmp_path, installed).run(words)
    assert done.returncode == 10
    assert "BAD   rover: frames" in done.stdout


def test_the_rig_is_one(tmp_path: Path) -> None:
    import tomllib

    assert RigSettings.model_validate(tomllib.loads(blocks("hardware", "toml")[0])).camera_to_antenna_m == (
        0.08,
        0.03,
        -0.24,
    )


def test_camera_axes_are_right_handed_and_look_down() -> None:
    rows = re.findall(r"^\| (\w+) \| `(\[.*\])` \|$", (GUIDE / "hardware.md").read_text(), re.MULTILINE)
    assert [edge for edge, _ in rows] == ["forward", "right", "backward", "left"]
    for edge, axes in rows:
        x, y, z = (np.array(BODY_AXES[name]) for name in json.loads(axes))
        assert np.array_equal(np.cross(x, y), z)
        assert np.array_equal(y, BODY_AXES[edge])
        assert np.array_equal(-z, BODY_AXES["down"])


def test_every_warning_is_explained() -> None:
    text = (GUIDE / "warnings.md").read_text(encoding="utf-8")
    cells = re.findall(r"^\| (`[^|]*?) \|", text, re.MULTILINE)
    explained = {code for cell in cells for code in re.findall("`(.*?)`", cell)}
    sources = _sources()
    named = {code for tree in sources for node in ast.walk(tree) for code in _codes_at(node)}
    named |= {one.code for one in FAULTS}
    assert named - explained == set()
    listed = {key.removeprefix("finding.") for key in catalogue("en").messages if key.startswith("finding.")}
    assert listed - explained == set()
    assert explained - listed == {"positions"}


def _sources() -> list[ast.Module]:
    # What a debrief says of a flight is no warning of the processing.
    paths = [path for folder in FOUND_IN for path in (ROOT / folder).rglob("*.py")]
    paths = [path for path in paths if path.parent.name != "debrief"]
    return [ast.parse(path.read_text("utf-8")) for path in [*paths, *(ROOT / one for one in FOUND_BY)]]


def _codes_at(node: ast.AST) -> Iterator[str]:
    """Codes of findings and tests, where they are written out."""
    called = isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    if called and node.func.id in ("Finding", "untested"):  # type: ignore[attr-defined]
        yield from _texts(node.args[:1])  # type: ignore[attr-defined]


def _texts(nodes: list[ast.expr]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value
