"""The journal of what was signed: never made unreadable, and whoever cuts or changes it is found."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from photocal.block.results.adjusted import adjust_block
from tests.photocal.conftest import Answer

DEMO = Path(__file__).resolve().parents[3] / "photocal" / "demo" / "dcs460"
Photocal = Callable[..., Answer]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("journal")
    adjust_block(DEMO, folder / "run")
    return folder / "run"


@pytest.fixture
def certificate(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, photocal: Photocal) -> Path:
    """A certificate that was signed three times by one laboratory."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    assert photocal("keys", "--new", "Laboratory").code == 0
    folder = tmp_path / "certificate"
    assert photocal("certificate", run, "-o", folder, "--block", DEMO, "--date", "2026-11-21").code == 0
    for _ in range(3):
        assert photocal("sign", folder).code == 0
    return folder


@pytest.fixture
def journal(certificate: Path) -> Path:
    return certificate.parent / "settings" / "photocal" / "journal.jsonl"


def entries(photocal: Photocal) -> int:
    answer = photocal("keys", "--journal", "--json")
    assert answer.code == 0, answer.err
    return len(json.loads(answer.out))


@pytest.mark.parametrize("left", [b'{"entry":4,"num', b"\x00\x00\x00", b"x", b"{}"])
def test_a_torn_last_line_is_set_aside_and_told(
    left: bytes, certificate: Path, journal: Path, photocal: Photocal
) -> None:
    """Finding 12: the next entry was written behind it, and nothing could read the journal any more."""
    journal.write_bytes(journal.read_bytes() + left)
    answer = photocal("keys", "--journal")
    assert answer.code == 4
    assert "ends within an entry" in answer.err
    answer = photocal("sign", certificate)
    assert answer.code == 0
    assert "a broken last line was moved to journal.torn" in answer.err
    assert (journal.parent / "journal.torn").read_bytes() == left + b"\n"
    assert entries(photocal) == 4
    assert photocal("verify", certificate, "--journal", journal).code == 0


def test_a_last_line_without_its_end_gets_one(certificate: Path, journal: Path, photocal: Photocal) -> None:
    journal.write_bytes(journal.read_bytes().rstrip(b"\n"))
    assert entries(photocal) == 3
    answer = photocal("sign", certificate)
    assert answer.code == 0
    assert "had no end" in answer.err
    assert entries(photocal) == 4
    assert photocal("verify", certificate, "--journal", journal).code == 0


def cut(content: bytes) -> bytes:
    return b"".join(content.splitlines(keepends=True)[:-1])


def torn_away(content: bytes) -> bytes:
    """The last entry had been written whole: what is left of it is not what a broken write leaves."""
    return content[:-40]


def another_entry(content: bytes) -> bytes:
    return content.replace(b'"number":"PC', b'"number":"XX', 1)


def without_a_middle(content: bytes) -> bytes:
    lines = content.splitlines(keepends=True)
    return lines[0] + lines[2]


def doubled_key(content: bytes) -> bytes:
    return content.replace(b'{"entry":1', b'{"entry":1,"entry":1', 1)


@pytest.mark.parametrize(
    "harm", [cut, torn_away, another_entry, without_a_middle, doubled_key, lambda _: b""]
)
def test_a_harmed_journal_is_found_and_nothing_is_added(
    harm: Callable[[bytes], bytes], certificate: Path, journal: Path, photocal: Photocal
) -> None:
    content = journal.read_bytes()
    journal.write_bytes(harm(content))
    signature = (certificate / "signature.json").read_bytes()
    assert photocal("keys", "--journal").code == 4
    answer = photocal("sign", certificate)
    assert answer.code == 4
    assert "copy of the journal" in answer.err
    assert journal.read_bytes() == harm(content)
    assert (certificate / "signature.json").read_bytes() == signature
    # With the copy in its place all goes on.
    journal.write_bytes(content)
    assert photocal("sign", certificate).code == 0
    assert entries(photocal) == 4


def test_a_cut_journal_without_its_head_is_found_by_a_signature(
    certificate: Path, journal: Path, photocal: Photocal, tmp_path: Path
) -> None:
    """Nobody can see the cut in the file alone; who has a signature of later has the proof."""
    elsewhere = tmp_path / "journal.jsonl"
    elsewhere.write_bytes(cut(journal.read_bytes()))
    assert photocal("keys", "--journal", "--file", elsewhere).code == 0
    answer = photocal("verify", certificate, "--journal", elsewhere)
    assert answer.code == 4
    assert "the journal was truncated: 2 entries, the signature names 3" in answer.err
    shutil.copyfile(journal, elsewhere)
    assert photocal("verify", certificate, "--journal", elsewhere).code == 0


def test_an_entry_written_before_the_computer_stopped_counts(
    certificate: Path, journal: Path, photocal: Photocal
) -> None:
    """The head is written after the entry: it may be one behind, never ahead."""
    head = journal.with_suffix(".head")
    before = head.read_bytes()
    assert photocal("sign", certificate).code == 0
    head.write_bytes(before)
    assert entries(photocal) == 4
    assert photocal("sign", certificate).code == 0
    assert entries(photocal) == 5


def test_a_journal_of_an_earlier_version_has_no_head_and_gets_one(
    certificate: Path, journal: Path, photocal: Photocal
) -> None:
    journal.with_suffix(".head").unlink()
    assert entries(photocal) == 3
    assert photocal("sign", certificate).code == 0
    assert json.loads(journal.with_suffix(".head").read_text(encoding="utf-8"))["entries"] == 4


def test_the_head_of_another_journal_is_refused(certificate: Path, journal: Path, photocal: Photocal) -> None:
    journal.with_suffix(".head").write_text(json.dumps({"entries": 3, "sha256": "0" * 64}), encoding="utf-8")
    assert "is not the journal of the head" in photocal("sign", certificate).err
    assert photocal("keys", "--journal").code == 4
