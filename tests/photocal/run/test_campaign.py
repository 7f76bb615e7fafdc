"""Several projects give the same one by one, on processes and on a cluster; one that fails stops none."""

from __future__ import annotations

import datetime as dt
import importlib
import re
import shutil
import subprocess
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.base import compiled
from photocal.base.errors import InputNotFoundError
from photocal.base.progress import Standing, quiet
from photocal.base.workers import Cluster
from photocal.block.project import read_project
from photocal.run.campaign import run_project, run_projects
from photocal.run.course import COMPILING
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
DAY = dt.date(2025, 6, 16)
PLAN = Plan(tie=30, estimate=("c",), mounting="lever_arm_sigma_m = 0.02\nboresight_sigma_deg = 0.5")
PROJECT = """
[project]
name = "{name}"
crs = "local"
height = "local"
output = "work"
[measurements]
block = "block"
"""


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flown")
    for seed, name in enumerate(("may", "june"), start=1):
        fly(folder / name / "block", np.random.default_rng(seed), Errors(), PLAN)
        (folder / name / "project.toml").write_text(PROJECT.format(name=name), encoding="utf-8")
    return folder


def campaign(flown: Path, folder: Path, **where: Any) -> list[dict[str, Any]]:
    """Run copies of the flights; their figures without times and places."""
    paths = []
    for name in ("may", "june"):
        shutil.copytree(flown / name, folder / name)
        paths.append(folder / name / "project.toml")
    found = run_projects(paths, DAY, until="calibration", **where)
    return [{key: one[key] for key in ("project", "calibration", "warnings")} for one in found]


@pytest.mark.slow
def test_everywhere_the_same(
    flown: Path, two_workers: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = campaign(flown, tmp_path / "alone")
    said = capsys.readouterr().err
    assert [one["project"] for one in alone] == ["may", "june"]
    assert alone[0]["calibration"]["cameras"] != alone[1]["calibration"]["cameras"]
    for name, where in (
        ("processes", {"workers": 2}),
        ("cluster", {"workers": Cluster(two_workers.scheduler_address)}),
    ):
        assert campaign(flown, tmp_path / name, **where) == alone
        # What the stages say comes back from there.
        told = capsys.readouterr().err
        assert [line.rsplit(":", 1)[0] for line in told.splitlines()] == [
            line.rsplit(":", 1)[0] for line in said.splitlines()
        ]


@pytest.mark.parametrize("elsewhere", [False, True], ids=["here", "cluster"])
def test_one_that_fails_stops_no_other(
    flown: Path, two_workers: Any, tmp_path: Path, elsewhere: bool
) -> None:
    crew = Cluster(two_workers.scheduler_address) if elsewhere else 1
    for name in ("may", "june"):
        shutil.copytree(flown / name, tmp_path / name)
    (tmp_path / "may" / "block" / "block.toml").unlink()
    paths = [tmp_path / name / "project.toml" for name in ("may", "june")]
    with pytest.raises(InputNotFoundError, match=r"block\.toml"):
        run_projects(paths, DAY, until="calibration", workers=crew)
    assert (tmp_path / "june" / "work" / "calibration" / "result.json").exists()


def test_what_compiles_after_an_installation_is_told(
    flown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody waits for the compiler without knowing it; a run that finds all it needs compiles nothing."""
    begun = list[str]()
    told = list[Standing]()

    class Begun:
        def __init__(self, command: list[str], **_: Any) -> None:
            begun.append(command[-1])

        def wait(self) -> int:
            # The bar is told once a second.
            time.sleep(1.5)
            return 0

        def kill(self) -> None:
            pass

    project = Path(shutil.copytree(flown / "may", tmp_path / "may")) / "project.toml"
    monkeypatch.setattr(compiled, "anything_compiled", lambda: False)
    monkeypatch.setattr(subprocess, "Popen", Begun)
    run_project(read_project(project), DAY, quiet, until="block", bar=lambda: nullcontext(told.append))
    assert len(begun) == 4
    # What fails in these processes is not told: their names must exist.
    for command in begun:
        module, function = re.fullmatch(r"import (\S+) as part; part\.(\w+)\(\)", command).groups()  # type: ignore[union-attr]
        assert callable(getattr(importlib.import_module(module), function))
    while_compiling = [now for now in told if now.stage == COMPILING]
    assert while_compiling[-1].title.startswith("compiling")
    assert while_compiling[-1].left_s > 5.0
    # The second time all is kept, and nothing is compiled for it.
    run_project(read_project(project), DAY, quiet, until="block")
    assert len(begun) == 4


def test_names_of_files_do_not_steer_the_terminal(
    flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stage tells of a file that somebody has put into its folder, by its name."""
    project = Path(shutil.copytree(flown / "may", tmp_path / "may")) / "project.toml"
    run_projects([project], DAY, until="calibration")
    (project.parent / "work" / "calibration" / "put \x1b[2Jhere.txt").write_text("mine", encoding="utf-8")
    capsys.readouterr()
    run_projects([project], DAY, until="calibration", again="calibration")
    said = capsys.readouterr().err
    assert "put ·[2Jhere.txt" in said
    assert "\x1b" not in said
