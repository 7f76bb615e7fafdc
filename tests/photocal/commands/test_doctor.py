"""Damaged set-ups are named, each with its remedy."""

from __future__ import annotations

import datetime as dt
import importlib.metadata
import json
import os
import shutil
import sys
import webbrowser
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from photocal.base import compiled
from photocal.base.console import Check
from photocal.commands import doctor
from photocal.commands.cli import app
from photocal.commands.doctor import examine
from photocal.findings.texts import catalogue

Patch = pytest.MonkeyPatch
ENGLISH = catalogue("en")


@pytest.fixture(autouse=True)
def settings(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    return tmp_path / "settings" / "photocal"


def old_python(_: Path, patch: Patch) -> None:
    patch.setattr(sys, "version_info", (3, 10, 4))


def lost_package(_: Path, patch: Patch) -> None:
    version = importlib.metadata.version

    def lacking(name: str) -> str:
        if name == "rasterio":
            raise importlib.metadata.PackageNotFoundError(name)
        return version(name)

    patch.setattr(importlib.metadata, "version", lacking)


def temporary_kernels(folder: Path, patch: Patch) -> None:
    patch.setattr(compiled, "FOLDER", folder / "kernels")


def no_engine(folder: Path, patch: Patch) -> None:
    patch.setenv("PATH", str(folder))


def another_engine(folder: Path, patch: Patch) -> None:
    for name in ("rnx2rtkp", "convbin"):
        (folder / name).write_text("#!/bin/sh\necho hello\n", encoding="utf-8")
        (folder / name).chmod(0o755)
    patch.setenv("PATH", str(folder), prepend=os.pathsep)


def no_browser(_: Path, patch: Patch) -> None:
    def none() -> None:
        raise webbrowser.Error("no browser")

    patch.setattr(webbrowser, "get", none)


def wrong_clock(_: Path, patch: Patch) -> None:
    class Clock(dt.datetime):
        @classmethod
        def now(cls, tz: dt.tzinfo | None = None) -> Clock:
            return cls(1970, 1, 1, tzinfo=tz)

    patch.setattr("photocal.commands.doctor.dt.datetime", Clock)


def full_disk(_: Path, patch: Patch) -> None:
    patch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1_000_000))


def little_memory(_: Path, patch: Patch) -> None:
    patch.setattr(os, "sysconf", lambda name: 4096 if name == "SC_PAGE_SIZE" else 200_000)


def old_leap_seconds(_: Path, patch: Patch) -> None:
    expired = SimpleNamespace(expires=dt.date(2026, 1, 1))
    patch.setattr("photocal.base.time_scales.installed_leap_seconds", lambda: expired)


def open_key(folder: Path, patch: Patch) -> None:
    settings = folder / "settings" / "photocal"
    settings.mkdir(parents=True)
    (settings / "key.json").write_text(json.dumps({"name": "x", "public": "AAAA"}), encoding="utf-8")
    settings.chmod(0o777)


DAMAGES: dict[Callable[[Path, Patch], None], tuple[str, str, str]] = {
    old_python: ("Python", "3.10.4 is too old", "install Python 3.11"),
    lost_package: ("packages", "rasterio missing", "pip install"),
    temporary_kernels: ("kernels", "which is not kept", "writable"),
    no_engine: ("PPK engine", "rnx2rtkp is missing", "rtklib"),
    another_engine: ("PPK engine", "does not answer", "rtklib"),
    no_browser: ("browser", "none: pages", "install one"),
    wrong_clock: ("clock", "says 1970-01-01", "set the clock"),
    full_disk: ("disk", "0 GB free", "free at least"),
    little_memory: ("memory", "0.8 GiB", "4 GiB"),
    old_leap_seconds: ("leap seconds", "known until 2026-01-01", "upgrade tzdata"),
    open_key: ("key", "open to others", "chmod 700"),
}


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_a_damaged_machine_is_named(
    damage: Callable[[Path, Patch], None], tmp_path: Path, monkeypatch: Patch
) -> None:
    part, text, remedy = DAMAGES[damage]
    with monkeypatch.context() as patch:
        damage(tmp_path, patch)
        checks = {check.part: check for check in examine(tmp_path, None, ENGLISH)}
    assert checks[part].state in ("poor", "bad")
    assert text in checks[part].text
    assert remedy in checks[part].remedy
    others = [check for check in checks.values() if check.part != part and text in check.text]
    assert not others


def test_a_port_that_may_not_be_opened_is_named(tmp_path: Path, monkeypatch: Patch) -> None:
    (tmp_path / "ttyUSB0").touch()
    monkeypatch.setattr(os, "access", lambda *_: False)
    check = doctor._serial(ENGLISH, tmp_path)
    assert (check[0], "dialout" in check[2]) == ("bad", True)


def test_missing_grids_are_named_with_their_command() -> None:
    check = {check.part: check for check in examine(Path(), "EPSG:31982+5773", ENGLISH)}["grids"]
    assert check == Check(
        "grids",
        "bad",
        "us_nga_egm96_15.tif missing for EPSG:31982+5773",
        "run: photocal fetch-grids EPSG:31982+5773",
    )
    answer = CliRunner().invoke(app, ["fetch-grids", "EPSG:31982+5773", "--dry-run", "--json"])
    assert json.loads(answer.stdout)["missing"] == ["us_nga_egm96_15.tif"]
    assert "no reference system" in str(CliRunner().invoke(app, ["fetch-grids", "EPSG:1"]).exception)


def test_every_part_has_a_line(tmp_path: Path) -> None:
    answer = CliRunner().invoke(app, ["doctor", str(tmp_path), "--json"])
    checks = json.loads(answer.stdout)
    assert len(checks) == 12
    assert all(check["remedy"] for check in checks if check["state"] != "good")


def test_it_speaks_the_language_of_the_machine_or_the_one_asked_for(tmp_path: Path) -> None:
    """Lines for people follow the environment, JSON does only what it is asked."""
    brazilian = {"LC_ALL": "pt_BR.UTF-8"}
    lines = CliRunner().invoke(app, ["doctor", str(tmp_path)], env=brazilian).output.splitlines()
    assert any(line.startswith("ok    Python: 3.") for line in lines)
    assert any("segundos intercalares: conhecidos até" in line for line in lines)
    assert not any("warning" in line or line.startswith("error") for line in lines)
    arguments = ["doctor", str(tmp_path), "--json"]
    english = json.loads(CliRunner().invoke(app, arguments, env=brazilian).stdout)
    asked = json.loads(CliRunner().invoke(app, [*arguments, "--language", "pt-BR"]).stdout)
    assert [check["part"] for check in english][-2:] == ["leap seconds", "key"]
    assert [check["part"] for check in asked][-2:] == ["segundos intercalares", "chave"]
    assert [check["state"] for check in asked] == [check["state"] for check in english]
