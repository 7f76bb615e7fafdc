"""Runs to certify, and a clock."""

from __future__ import annotations

import datetime as dt
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import photocal.commands.verify
import photocal.report.keys
from photocal.findings.document import Document
from photocal.findings.texts import catalogue
from photocal.report.certificate import certificate
from photocal.report.certificate_metadata import read_particulars
from photocal.report.stored_analysis import AnalysedRun, read_run

DAY = dt.date(2026, 11, 21)


def _runs() -> ModuleType:
    # importlib mode has no package for test helpers: load the one beside this file by its path.
    spec = importlib.util.spec_from_file_location("report_runs", Path(__file__).with_name("runs.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["report_runs"] = module
    spec.loader.exec_module(module)
    return module


RUNS = _runs()


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    """An invented run in pixels with check points, to spoil."""
    folder: Path = RUNS.invented(tmp_path / "run")
    return folder


@pytest.fixture(scope="session")
def large_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """More images and rays than a page takes."""
    folder: Path = RUNS.invented(tmp_path_factory.mktemp("large") / "run", images=120, rays=40)
    return folder


@pytest.fixture(scope="session")
def published_folder(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The published DCS460 calibration as a run."""
    folder: Path = RUNS.dcs460(shared / "reference" / "dcs460", tmp_path_factory.mktemp("dcs460") / "run")
    return folder


@pytest.fixture(scope="session")
def invented_run(tmp_path_factory: pytest.TempPathFactory) -> AnalysedRun:
    """An invented run in pixels with check points, to read only."""
    return read_run(RUNS.invented(tmp_path_factory.mktemp("invented") / "run"))


@pytest.fixture(scope="session")
def published_run(published_folder: Path) -> AnalysedRun:
    """The published DCS460 calibration."""
    return read_run(published_folder)


@pytest.fixture(scope="session", params=["en", "pt-BR"])
def document(request: pytest.FixtureRequest, invented_run: AnalysedRun) -> Document:
    """The certificate of the invented run in each language."""
    particulars = read_particulars(None, DAY, client="Client <b>&</b> Sons", operator="Laboratório")
    return certificate(invented_run, particulars, catalogue(request.param))


@pytest.fixture
def on_day(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Let the program's clock stand at noon of a day."""

    def go(day: str) -> None:
        noon = dt.datetime.fromisoformat(f"{day}T12:00:00+00:00")

        class Clock(dt.datetime):
            @classmethod
            def now(cls, tz: dt.tzinfo | None = None) -> dt.datetime:  # type: ignore[override]
                return noon.astimezone(tz)

        for module in (photocal.commands.verify, photocal.report.keys):
            monkeypatch.setattr(module, "dt", SimpleNamespace(**{**vars(dt), "datetime": Clock}))

    return go
