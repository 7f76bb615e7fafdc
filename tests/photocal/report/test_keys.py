"""Keys, their names and lists: what somebody writes into a name never speaks for the program."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from photocal.block.results.adjusted import adjust_block
from tests.photocal.conftest import Answer

DEMO = Path(__file__).resolve().parents[3] / "photocal" / "demo" / "dcs460"
Photocal = Callable[..., Answer]
HARMLESS = "Harmless"
BIG = "Big Laboratory"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    adjust_block(DEMO, folder / "run")
    return folder / "run"


@pytest.fixture
def as_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Be another person from now on; returns that person's folder of keys."""

    def be(name: str) -> Path:
        monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / name))
        return tmp_path / name / "photocal"

    return be


@pytest.fixture
def signed(
    run: Path, tmp_path: Path, as_user: Callable[[str], Path], photocal: Photocal
) -> Callable[[str, str], Path]:
    """A certificate of a person with a key of that name, signed."""

    def make(person: str, name: str) -> Path:
        as_user(person)
        assert photocal("keys", "--new", name).code == 0
        folder = tmp_path / f"of {person}"
        assert photocal("certificate", run, "-o", folder, "--block", DEMO, "--date", "2026-11-21").code == 0
        assert photocal("sign", folder).code == 0
        return folder

    return make


def sign_again(settings: Path, folder: Path, **changed: Any) -> None:
    """Sign with a key outside the program, as a forger does who writes his own: RFC 8032 over sorted JSON."""
    private: Any = load_pem_private_key((settings / "key.pem").read_bytes(), None)
    content = json.loads((folder / "signature.json").read_text(encoding="utf-8")) | changed
    del content["signature"]
    octets = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()
    content["signature"] = base64.b64encode(private.sign(octets)).decode()
    (folder / "signature.json").write_text(json.dumps(content), encoding="utf-8")


EVIL = {
    "second key": "Harmless\n" + "ABCD " * 10 + BIG,
    "end of a line": "Harmless\u2028x",
    "escape": "Lab \x1b[1A\x1b[2K",
    "zero width": "Big\u200b Laboratory",
    "right to left": "\u202eyrotarobaL giB",
    "another alphabet": "Big Lab\u043eratory",
    "blanks": "   ",
    "without end": "x" * 101,
}


@pytest.mark.parametrize("name", EVIL)
def test_such_a_name_is_refused_when_made(
    name: str, as_user: Callable[[str], Path], photocal: Photocal
) -> None:
    settings = as_user("forger")
    answer = photocal("keys", "--new", EVIL[name])
    assert answer.code == 5
    assert len(answer.err.splitlines()) == 1
    assert not settings.exists()


@pytest.mark.parametrize("name", [*EVIL.values(), f"{BIG} ", f"{BIG}  of Somewhere", "Ｂｉｇ"])
def test_such_a_name_in_a_signature_is_forged_and_never_remembered(
    name: str, signed: Callable[[str, str], Path], as_user: Callable[[str], Path], photocal: Photocal
) -> None:
    """Findings 7 and 9 of the review: a name with a line break admitted a second key under any name."""
    folder = signed("forger", HARMLESS)
    settings = as_user("forger")
    sign_again(settings, folder, name=name)
    victim = as_user("victim")
    answer = photocal("verify", folder, "--trust")
    assert answer.code == 4
    assert "the name of its key" in answer.err
    assert not (victim / "trusted_keys.txt").exists()
    assert [line for line in answer.out.splitlines() if line.startswith(("authentic", "not authentic"))] == [
        answer.out.splitlines()[-1]
    ]


def test_trust_writes_one_entry_and_leaves_the_others(
    signed: Callable[[str, str], Path], as_user: Callable[[str], Path], photocal: Photocal
) -> None:
    folder = signed("office", "Laboratório de fotogrametria (Kürzel: LF) # 1")
    listed = as_user("client") / "trusted_keys.txt"
    listed.parent.mkdir(mode=0o700, parents=True)
    before = f"# compared by telephone\n{'0123 ' * 10}Another\n"
    listed.write_text(before, encoding="utf-8")
    assert photocal("verify", folder).code == 12
    assert photocal("verify", folder, "--trust").code == 0
    said = json.loads(photocal("verify", folder, "--json").out)
    key = said["signature"]["fingerprint"]
    assert (
        listed.read_text(encoding="utf-8") == f"{before}{key} Laboratório de fotogrametria (Kürzel: LF) # 1\n"
    )
    assert photocal("verify", folder, "--trust").code == 0
    assert listed.read_text(encoding="utf-8").count(key) == 1


def test_a_name_cannot_write_the_verdict(
    signed: Callable[[str, str], Path], as_user: Callable[[str], Path], photocal: Photocal
) -> None:
    """Finding 8: the name ended in words of ours; now it stands between quotes, behind its key."""
    words = 'Big" with the key 0000, which is known authentic: signed by "Big'
    folder = signed("forger", words)
    as_user("victim")
    answer = photocal("verify", folder)
    last = answer.out.splitlines()[-1]
    key = json.loads((folder / "signature.json").read_text(encoding="utf-8"))["fingerprint"]
    quoted = words.replace('"', "'")
    assert last.startswith(f'not authentic: signed with the key {key} by "{quoted}", not known here')
    assert answer.code == 12


@pytest.mark.parametrize("name", ["Big Laboratory", "BIG LABORATORY", "big laboratory"])
def test_a_known_name_with_another_key_is_refused_in_any_case(
    name: str, signed: Callable[[str, str], Path], as_user: Callable[[str], Path], photocal: Photocal
) -> None:
    right, wrong = signed("office", BIG), signed("forger", name)
    as_user("client")
    assert photocal("verify", right, "--trust").code == 0
    for arguments in (("verify", wrong), ("verify", wrong, "--trust")):
        answer = photocal(*arguments)
        assert answer.code == 4
        assert "known by another key" in answer.err


def test_letters_of_another_alphabet_throughout_stay_unknown(
    signed: Callable[[str, str], Path], as_user: Callable[[str], Path], photocal: Photocal
) -> None:
    """Whole words of Cyrillic letters that look Latin are a name like any other: only the key tells."""
    right, wrong = signed("office", "COBA"), signed("forger", "\u0421\u041e\u0412\u0410")
    as_user("client")
    assert photocal("verify", right, "--trust").code == 0
    assert photocal("verify", wrong).code == 12


def test_exit_codes_of_unsigned_unknown_known_and_revoked(
    signed: Callable[[str, str], Path],
    as_user: Callable[[str], Path],
    photocal: Photocal,
    tmp_path: Path,
) -> None:
    folder = signed("office", BIG)
    key = json.loads(photocal("keys", "--json").out)["own"]
    assert photocal("verify", folder).code == 0
    client = as_user("client")
    assert photocal("verify", folder).code == 12
    assert photocal("verify", folder, "--trust").code == 0
    # A list from the issuer's page ...
    revoked = tmp_path / "revoked.txt"
    revoked.write_text(f"# read on our page\n{key} 2026-11-22 computer stolen\n", encoding="utf-8")
    answer = photocal("verify", folder, "--revoked", revoked)
    assert answer.code == 4
    assert "revoked on 2026-11-22 (computer stolen)" in answer.out.splitlines()[-1]
    # ... or beside the known keys: for ever, also for the list that names it.
    shutil.copyfile(revoked, client / "revoked_keys.txt")
    assert photocal("verify", folder).code == 4
    assert photocal("verify", folder, "--trust").code == 4
    assert "revoked on 2026-11-22" in photocal("keys").out
    revoked.write_text(f"{key} soon\n", encoding="utf-8")
    assert "line 1: 'soon' is not a date" in photocal("verify", folder, "--revoked", revoked).err
    # Who has it may not sign with it any more.
    office = as_user("office")
    (office / "revoked_keys.txt").write_text(f"{key} 2026-11-22\n", encoding="utf-8")
    answer = photocal("sign", folder)
    assert answer.code == 5
    assert "revoked on 2026-11-22" in answer.err
    (folder / "signature.json").unlink()
    as_user("client")
    content = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    assert content["particulars"]["responsible"]["key"] == key
    assert photocal("verify", folder).code == 4  # the certificate names a key and is not signed by it


def test_a_key_ends_on_its_last_day(
    run: Path,
    tmp_path: Path,
    as_user: Callable[[str], Path],
    photocal: Photocal,
    on_day: Callable[[str], None],
) -> None:
    """Its signatures expire with it, also where the thief of a key leaves its day away."""
    on_day("2026-11-27")
    office = as_user("office")
    for wrong in ("2026-11-26", "31.12.2026"):
        assert photocal("keys", "--new", BIG, "--expires", wrong).code == 5
    assert photocal("keys", "--expires", "2026-12-31").code == 5
    assert photocal("keys", "--new", BIG, "--expires", "2026-12-31").code == 0
    folder = tmp_path / "certified"
    assert photocal("certificate", run, "-o", folder, "--block", DEMO).code == 0
    assert photocal("sign", folder).code == 0
    client = as_user("client")
    assert photocal("verify", folder, "--trust").code == 0
    assert " 2026-12-31 " in (client / "trusted_keys.txt").read_text(encoding="utf-8")
    on_day("2026-12-31")
    assert photocal("verify", folder).code == 0
    on_day("2027-01-01")
    answer = photocal("verify", folder)
    assert answer.code == 12
    assert "expired on 2026-12-31" in answer.err
    # Who still has the key leaves the day away, and signs: the client knows better.
    content = json.loads((folder / "signature.json").read_text(encoding="utf-8"))
    del content["expires"]
    (folder / "signature.json").write_text(json.dumps(content), encoding="utf-8")
    sign_again(office, folder)
    assert photocal("verify", folder).code == 12
    # A stranger who never knew the key does not come to know it so.
    as_user("stranger")
    assert photocal("verify", folder, "--trust").code == 0
    as_user("office")
    answer = photocal("sign", folder)
    assert answer.code == 5
    assert "your own key expired on 2026-12-31" in answer.err


def test_an_unsigned_certificate_has_a_code_of_its_own(
    run: Path, tmp_path: Path, as_user: Callable[[str], Path], photocal: Photocal
) -> None:
    as_user("nobody")
    assert photocal("certificate", run, "-o", tmp_path / "c", "--block", DEMO).code == 0
    answer = photocal("verify", tmp_path / "c")
    assert answer.code == 11
    assert answer.out.splitlines()[-1] == "not authentic: it is not signed"


@pytest.mark.parametrize(
    ("line", "cause"),
    [
        ("ABCD " * 10 + "Lab\u2028" + "0123 " * 10 + BIG, "U+2028"),
        ("ABCD " * 10 + "Lab\x0b" + "0123 " * 10 + BIG, "U+000B"),
        ("WXYZ " * 10 + "Lab", "is not a key"),
        ("ABCD " * 10 + "Lab\n" + "abcd " * 10 + "Lab", "already listed above"),
    ],
)
def test_a_list_of_keys_means_one_thing(
    line: str, cause: str, tmp_path: Path, run: Path, as_user: Callable[[str], Path], photocal: Photocal
) -> None:
    as_user("client")
    assert photocal("certificate", run, "-o", tmp_path / "c", "--block", DEMO).code == 0
    (tmp_path / "keys.txt").write_text(f"{line}\n", encoding="utf-8")
    answer = photocal("verify", tmp_path / "c", "--keys", tmp_path / "keys.txt")
    assert answer.code == 4
    assert cause in answer.err


@pytest.mark.skipif(os.name == "nt", reason="Windows has access lists, not modes")
@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604, 0o602])
def test_a_key_that_others_can_open_does_not_sign(
    mode: int, signed: Callable[[str, str], Path], as_user: Callable[[str], Path], photocal: Photocal
) -> None:
    folder = signed("office", BIG)
    key = as_user("office") / "key.pem"
    key.chmod(mode)
    answer = photocal("sign", folder)
    assert answer.code == 5
    assert f"chmod 600 {key}" in answer.err
    key.chmod(0o600)
    assert photocal("sign", folder).code == 0


def test_a_signature_does_not_serve_another_certificate(
    run: Path, signed: Callable[[str, str], Path], tmp_path: Path, photocal: Photocal
) -> None:
    folder = signed("office", BIG)
    other = tmp_path / "other"
    assert photocal("certificate", run, "-o", other, "--block", DEMO, "--client", "another").code == 0
    shutil.copyfile(folder / "signature.json", other / "signature.json")
    answer = photocal("verify", other)
    assert answer.code == 4
    assert "was made for the certificate" in answer.out


def test_exchanged_attachments_are_named(signed: Callable[[str, str], Path], photocal: Photocal) -> None:
    folder = signed("office", BIG)
    one, other = folder / "inputs" / "images.csv", folder / "inputs" / "points.csv"
    images = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(images)
    answer = photocal("verify", folder)
    assert answer.code == 4
    assert "inputs/images.csv was changed after signing" in answer.out
    assert "inputs/points.csv was changed after signing" in answer.out


UPDATE = (
    b"\n9999 0 obj\n<< /Type /OCG /Name (hidden layer) >>\nendobj\n"
    b"xref\n9999 1\n%010d 00000 n \ntrailer\n<< /Size 10000 /Prev %d >>\nstartxref\n%d\n%%%%EOF\n"
)


@pytest.mark.parametrize("key", [True, False])
def test_a_later_layer_of_the_pdf_is_found(
    key: bool, signed: Callable[[str, str], Path], as_user: Callable[[str], Path], photocal: Photocal
) -> None:
    """An incremental update (ISO 32000-1, 7.5.6) leaves all bytes before it; also when it is signed."""
    folder = signed("forger", HARMLESS)
    settings = as_user("forger")
    path = folder / "certificate.pdf"
    content = path.read_bytes()
    start = int(content[content.rindex(b"startxref") + 9 :].split()[0])
    update = UPDATE % (len(content) + 1, start, len(content) + 60)
    path.write_bytes(content + update)
    record = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    if key:
        record["documents"]["certificate.pdf"] = hashlib.sha256(path.read_bytes()).hexdigest()
        (folder / "certificate.json").write_text(json.dumps(record), encoding="utf-8")
        digests = {
            p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
            for p in folder.rglob("*")
            if p.is_file() and p.name != "signature.json"
        }
        sign_again(settings, folder, files=digests)
    answer = photocal("verify", folder)
    assert answer.code == 4
    assert "certificate.pdf does not agree with the figures" in answer.out or not key
    assert "certificate.pdf was changed after signing" in answer.out or key


@pytest.mark.parametrize("name", ["certificate.json", "signature.json"])
def test_doubled_keys_are_refused(name: str, signed: Callable[[str, str], Path], photocal: Photocal) -> None:
    """Finding 11: the first `number` was forged, the second, which the program read, was right."""
    folder = signed("office", BIG)
    text = (folder / name).read_text(encoding="utf-8")
    (folder / name).write_text('{"number": "PC-FORGED",' + text[1:], encoding="utf-8")
    answer = photocal("verify", folder)
    assert answer.code == 4
    assert "'number' twice" in answer.err


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999"])
def test_what_is_no_number_is_refused(
    number: str, signed: Callable[[str, str], Path], photocal: Photocal
) -> None:
    folder = signed("office", BIG)
    text = (folder / "signature.json").read_text(encoding="utf-8")
    (folder / "signature.json").write_text(f'{{"more": {number},' + text[1:], encoding="utf-8")
    answer = photocal("verify", folder)
    assert answer.code == 4
    assert number in answer.err


@pytest.mark.parametrize(
    "changed",
    [
        {"signature": None},
        {"signature": "AAAA"},
        {"signature": 5},
        {"name": None},
        {"public_key": "AAAA"},
        {"files": []},
        {"files": 5},
        {"journal": 5},
        {"schema": "photocal.signature/9"},
    ],
)
def test_a_signature_of_another_kind_is_forged(
    changed: dict[str, Any], signed: Callable[[str, str], Path], photocal: Photocal
) -> None:
    folder = signed("office", BIG)
    path = folder / "signature.json"
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")) | changed), encoding="utf-8")
    answer = photocal("verify", folder)
    assert answer.code == 4
    assert answer.out.splitlines()[-1].startswith("not authentic: signed with the key")
    # A slow machine tells before it how long the repeating will take.
    assert [line[:6] for line in answer.err.splitlines() if not line.startswith("repeating: ")] == ["error:"]
