"""Whatever is changed in a certificate's folder is found and named; who has no key is not authentic."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from photocal.base.errors import NotSignedError, UnknownSignerError
from photocal.block.results.adjusted import adjust_block
from photocal.block.results.folder import BlockSource
from photocal.commands.cli import app
from photocal.report.issue import read_record
from photocal.report.verification import pages_of, repeated

DEMO = Path(__file__).resolve().parents[3] / "photocal" / "demo" / "dcs460"
HTML, PDF, RECORD = "certificate.html", "certificate.pdf", "certificate.json"


def call(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def done(*arguments: object) -> str:
    answer = call(*arguments)
    assert answer.exit_code == 0, answer.exception
    return answer.output


@pytest.fixture(scope="module")
def office(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Two certificates of one laboratory, the second signed, and its key and journal."""
    folder = tmp_path_factory.mktemp("office")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(folder / "settings"))
        done("keys", "--new", "Laboratory")
        adjust_block(DEMO, folder / "run")
        for name, day, language in (("older", "2026-11-20", "pt-BR"), ("signed", "2026-11-21", "en")):
            certificate = ("certificate", folder / "run", "-o", folder / name, "--block", DEMO)
            done(*certificate, "--date", day, "--language", language)
            done("sign", folder / name)
        certified, where = read_record(folder / "signed")
        # The inputs are the same whenever this is asked: what is not them would be named before.
        run = repeated(certified, where, BlockSource(where / "inputs"))
        patch.setattr("photocal.report.verification.repeated", lambda *_: run)
        pages = dict[str, dict[str, bytes]]()

        def printed_once(run: Any, certified: dict[str, Any]) -> dict[str, bytes]:
            """What a certificate states, but for the digests of its pages, is all that they are made of."""
            stated = json.dumps({name: part for name, part in certified.items() if name != "documents"})
            if stated not in pages:
                pages[stated] = pages_of(run, certified)
            return pages[stated]

        patch.setattr("photocal.report.verification.pages_of", printed_once)
        yield folder


@pytest.fixture
def folder(office: Path, tmp_path: Path) -> Path:
    """A copy of the signed certificate, to change."""
    return Path(shutil.copytree(office / "signed", tmp_path / "certificate"))


def set_field(*steps: Any, to: Any) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        content = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        place = content
        for step in steps[:-1]:
            place = place[step]
        place[steps[-1]] = to
        (folder / RECORD).write_text(json.dumps(content), encoding="utf-8")

    return change


def page(name: str, change: Callable[[bytes], bytes], *, certified: bool = True) -> Callable[[Path], None]:
    """Change a page, and put its new digest into the record."""

    def both(folder: Path) -> None:
        content = change((folder / name).read_bytes())
        (folder / name).write_bytes(content)
        if certified:
            set_field("documents", name, to=hashlib.sha256(content).hexdigest())(folder)

    return both


def digit(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "inputs" / name
        path.write_bytes(re.sub(rb"\d", lambda m: b"7" if m[0] != b"7" else b"8", path.read_bytes(), count=1))

    return change


def link(name: str) -> Callable[[Path], None]:
    """Let a link to the very same content take the place of a file or folder."""

    def change(folder: Path) -> None:
        aside = folder.with_name("aside")
        (folder / name).rename(aside)
        (folder / name).symlink_to(aside)

    return change


def add(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("more", encoding="utf-8")

    return change


def remove(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def other(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        office = Path(os.environ["XDG_CONFIG_HOME"]).parent
        shutil.copyfile(office / "older" / name, folder / name)

    return change


def moved_line(content: bytes) -> bytes:
    start = content.index(b"<svg")
    numbers = [m for m in re.finditer(rb"M (\d+\.\d+)", content) if m.start() > start]
    m = numbers[len(numbers) // 2]
    return content[: m.start(1)] + b"%.3f" % (float(m[1]) + 3.0) + content[m.end(1) :]


INPUTS = ("block.toml", "images.csv", "points.csv", "observations.csv")
CAMERA = ("result", "cameras", "dcs460")
FORGED = b"<style>dd{color:red}</style></head>"
WAYS: dict[str, tuple[Callable[[Path], None], str]] = {
    **{f"digit of {name}": (digit(name), f"{name} has changed") for name in INPUTS},
    **{f"no {name}": (remove(f"inputs/{name}"), f"{name} is missing") for name in INPUTS},
    "another input": (add("inputs/distances.csv"), "inputs/distances.csv is not part"),
    "another page": (add("certificate-corrected.html"), "certificate-corrected.html is not part"),
    "hidden file": (add(".certificate.json"), ".certificate.json is not part"),
    "another folder": (add("annex/figures.csv"), "annex/figures.csv is not part"),
    "empty folder": (lambda folder: (folder / "annex").mkdir(), "annex is not part"),
    "no page": (remove(HTML), f"{HTML} is missing"),
    "no PDF": (remove(PDF), f"{PDF} is missing"),
    "figure of the page": (
        page(HTML, lambda c: c.replace(b"20.50", b"21.50"), certified=False),
        f"{HTML} is not the one",
    ),
    "figure and digest": (page(HTML, lambda c: c.replace(b"20.50", b"21.50")), f"{HTML} does not agree"),
    "digit and digest": (
        page(HTML, lambda c: c.replace(b"20.5005", b"20.5006")),
        f"{HTML} does not agree",
    ),
    "style and digest": (
        page(HTML, lambda c: c.replace(b"</head>", FORGED)),
        f"{HTML} does not agree",
    ),
    "drawn line and digest": (page(HTML, moved_line), f"{HTML} does not agree"),
    "PDF and digest": (page(PDF, lambda c: c + b"%%EOF\n"), f"{PDF} does not agree"),
    "PDF of another": (other(PDF), f"{PDF} is not the one"),
    "page of another": (other(HTML), f"{HTML} is not the one"),
    "older record": (other(RECORD), HTML),
    "signature of another": (other("signature.json"), "was changed after signing"),
    "no documents": (set_field("documents", to={}), f"{HTML} is not among the documents"),
    "document elsewhere": (set_field("documents", "../x.pdf", to="0" * 64), "../x.pdf is not a document"),
    "page is a link": (link(HTML), f"{HTML} is a link"),
    "input is a link": (link("inputs/points.csv"), "inputs/points.csv is a link"),
    "inputs are a link": (link("inputs"), "inputs is a link"),
    "record is a link": (link(RECORD), RECORD),
    "input elsewhere": (set_field("result", "inputs", 0, "path", to="../../etc/passwd"), "lies outside"),
    "set-up elsewhere": (set_field("result", "block", "setup", to="/etc/passwd"), "lies outside"),
    "digest of an input": (set_field("result", "inputs", 2, "sha256", to="0" * 64), "points.csv has changed"),
    "number": (set_field("number", to="PC-20261121-00000000"), "number"),
    "date": (set_field("date", to="2026-11-22"), "number"),
    "client": (set_field("particulars", "document", "client", to="another"), "number"),
    "language": (set_field("language", to="pt-BR"), "technical_reports"),
    "warning": (set_field("warnings", to=[{"code": "no-control", "severity": "doubtful"}]), "number"),
    "value": (set_field(*CAMERA, "parameters", "c", "value", to=20.500468), "parameters.c.value"),
    "sigma": (set_field(*CAMERA, "parameters", "K3", "sigma", to=1.55e-10), "parameters.K3.sigma"),
    "correlation": (set_field(*CAMERA, "correlation", "matrix", 3, 0, to=0.5), "correlation.matrix[3][0]"),
    "test": (set_field("result", "global_test", "accepted", to=False), "global_test.accepted"),
    "iterations": (set_field("result", "iterations", to=60), "result.iterations"),
    "folder of the block": (set_field("result", "block", "source", to="/home"), "result.block.source"),
    "orientation": (set_field("exposures", 2, "Z_m", "value", to=6.7), "exposures[4].Z_m.value"),
    "row of the form": (set_field("technical_reports", "dcs460", 24, "value", to="12"), "technical_reports"),
    "digest of the run": (set_field("run_files", 0, "sha256", to="0" * 64), f"{HTML} does not agree"),
    "another field": (set_field("remark", to="checked"), "remark"),
    "schema": (set_field("schema", to="photocal.certificate/0"), "schema"),
    "no signature": (remove("signature.json"), "signature.json is missing"),
}


def test_there_are_enough_ways() -> None:
    assert len(WAYS) >= 40


@pytest.mark.parametrize("way", WAYS)
def test_a_changed_folder_is_found_and_named(folder: Path, way: str) -> None:
    change, named = WAYS[way]
    change(folder)
    answer = call("verify", folder, "--json")
    assert answer.exit_code != 0
    assert named in str(answer.exception) + answer.output
    assert '"verified": true' not in answer.output


def test_the_signed_certificate_is_reproducible_and_authentic(folder: Path) -> None:
    said = json.loads(done("verify", folder, "--json"))
    assert (said["verified"], said["reproducible"], said["authentic"]) == (True, True, True)
    key = said["signature"]["fingerprint"]
    assert key in (folder / HTML).read_text(encoding="utf-8")
    assert key in done("keys")


def test_a_new_record_without_the_key_is_reproducible_and_not_authentic(
    office: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody with the program makes a whole certificate under the laboratory's name."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "forger"))
    forged = tmp_path / "forged"
    certificate = ("certificate", office / "run", "-o", forged, "--block", DEMO, "--operator", "Laboratory")
    done(*certificate, "--date", "2026-11-21")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(office / "settings"))
    unsigned = call("verify", forged, "--json")
    assert unsigned.exit_code == 1
    assert isinstance(unsigned.exception, NotSignedError)
    said = json.loads(unsigned.stdout)
    assert (said["reproducible"], said["authentic"]) == (True, False)
    assert "not authentic: it is not signed" in call("verify", forged).output
    # With a key of his own, under the same name: refused by who knows the right one ...
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "forger"))
    done("keys", "--new", "Laboratory")
    done(*certificate, "--date", "2026-11-21")
    done("sign", forged)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(office / "settings"))
    assert "known by another key" in str(call("verify", forged).exception)
    assert "known by another key" in str(call("verify", forged, "--trust").exception)
    # ... and not authentic for who knows none, until that person has compared and trusts it.
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "client"))
    unknown = call("verify", office / "signed", "--json")
    assert isinstance(unknown.exception, UnknownSignerError)
    assert json.loads(unknown.stdout)["authentic"] is False
    assert json.loads(done("verify", office / "signed", "--json", "--trust"))["authentic"] is True
    assert json.loads(done("verify", office / "signed", "--json"))["authentic"] is True
    assert "known by another key" in str(call("verify", forged).exception)


def test_a_list_of_keys_must_have_the_signer(office: Path, folder: Path, tmp_path: Path) -> None:
    listed = tmp_path / "keys.txt"
    own = json.loads(done("keys", "--json"))["own"]
    listed.write_text(f"# ours\n{own} Laboratory\n", encoding="utf-8")
    assert json.loads(done("verify", folder, "--keys", listed, "--json"))["authentic"] is True
    listed.write_text(f"{'0000 ' * 10} Another\n", encoding="utf-8")
    assert "not authentic" in str(call("verify", folder, "--keys", listed).exception)
    listed.write_text("nonsense\n", encoding="utf-8")
    assert "line 1" in str(call("verify", folder, "--keys", listed).exception)


def test_the_journal_shows_a_later_exchange(office: Path, folder: Path, tmp_path: Path) -> None:
    journal = tmp_path / "journal.jsonl"
    shutil.copyfile(office / "settings" / "photocal" / "journal.jsonl", journal)
    done("verify", folder, "--journal", journal)
    lines = journal.read_bytes().splitlines(keepends=True)
    assert len(lines) == 2
    for changed in (lines[1:], [lines[0].replace(b"2026", b"2025", 1), lines[1]], lines[::-1]):
        journal.write_bytes(b"".join(changed))
        assert "does not follow" in str(call("verify", folder, "--journal", journal).exception)
    journal.write_bytes(lines[0])
    assert "the journal has no certificate" in str(call("verify", folder, "--journal", journal).exception)


def test_the_key_is_closed_to_others_and_never_replaced(office: Path) -> None:
    key = office / "settings" / "photocal" / "key.pem"
    assert key.stat().st_mode & 0o077 == 0
    assert key.parent.stat().st_mode & 0o077 == 0
    assert "there is a key already" in str(call("keys", "--new", "Laboratory").exception)


def test_a_signed_certificate_is_not_written_over(office: Path, folder: Path, tmp_path: Path) -> None:
    """A signature that stays beside another certificate would make a false one of it."""
    number = read_record(folder)[0]["number"]
    held = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    again = ("certificate", office / "run", "-o", folder, "--block", DEMO)
    done(*again, "--client", "Another client")
    assert not (folder / "signature.json").exists()
    kept = folder.with_name(f"{folder.name}-{number}")
    assert {path.name: path.read_bytes() for path in kept.iterdir() if path.is_file()} == held
    assert "authentic" in done("verify", kept)
    # The same certificate, made again, keeps its signature.
    done("sign", folder)
    done(*again, "--client", "Another client")
    assert (folder / "signature.json").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == [folder.name, kept.name]
