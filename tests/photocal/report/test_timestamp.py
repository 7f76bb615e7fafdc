"""Time stamps against an authority of its own: OpenSSL's, a program that shares nothing with ours."""

from __future__ import annotations

import datetime as dt
import json
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError, OutputError
from photocal.block.results.adjusted import adjust_block
from photocal.findings.texts import catalogue
from photocal.report.signing import STAMP, stamp, stamped
from tests.photocal.conftest import Answer

DEMO = Path(__file__).resolve().parents[3] / "photocal" / "demo" / "dcs460"
OPENSSL = shutil.which("openssl")
pytestmark = pytest.mark.skipif(
    OPENSSL is None, reason="openssl, the independent authority, is not installed"
)

CONFIG = """
[tsa]
default_tsa = tsa1
[tsa1]
serial = {folder}/serial
signer_digest = sha256
default_policy = 1.2.3.4.1
digests = sha256, sha384, sha512
accuracy = secs:1
ess_cert_id_chain = no
ess_cert_id_alg = sha256
"""


@dataclass(frozen=True)
class Authority:
    """A time stamping authority: its address, and its root."""

    folder: Path
    address: str

    @property
    def root(self) -> Path:
        return self.folder / "ca.pem"


def _openssl(*arguments: str | Path, folder: Path) -> None:
    subprocess.run([str(OPENSSL), *map(str, arguments)], cwd=folder, check=True, capture_output=True)


def certified(folder: Path, name: str) -> None:
    """Make a root, and a certificate of it that may stamp."""
    folder.mkdir()
    (folder / "serial").write_text("01\n", encoding="ascii")
    (folder / "tsa.cnf").write_text(CONFIG.format(folder=folder), encoding="ascii")
    (folder / "ext").write_text(
        "extendedKeyUsage=critical,timeStamping\nkeyUsage=critical,digitalSignature\n"
    )
    key = ("-newkey", "rsa:2048", "-nodes")
    root = ("-x509", "-days", "30", "-subj", f"/CN=Root of {name}", "-keyout", "ca.key", "-out", "ca.pem")
    _openssl("req", *key, *root, folder=folder)
    _openssl("req", *key, "-subj", f"/CN={name}", "-keyout", "tsa.key", "-out", "tsa.csr", folder=folder)
    signed = ("-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "30", "-extfile", "ext")
    _openssl("x509", "-req", "-in", "tsa.csr", *signed, "-out", "tsa.pem", folder=folder)


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Authority]:
    folder = tmp_path_factory.mktemp("tsa") / "authority"
    certified(folder, "Time of the test")

    class Answers(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            query = self.rfile.read(int(self.headers["Content-Length"]))
            if self.path == "/large":
                answer = bytes(1 << 17)
            elif self.path == "/page":
                answer = b"<html>not here</html>"
            else:
                (folder / "query").write_bytes(query if self.path == "/" else (folder / "last").read_bytes())
                (folder / "last").write_bytes(query)
                keys = ("-signer", "tsa.pem", "-inkey", "tsa.key")
                asked = ("ts", "-reply", "-config", "tsa.cnf", "-queryfile", "query")
                _openssl(*asked, *keys, "-out", "answer", folder=folder)
                answer = (folder / "answer").read_bytes()
            self.send_response(200)
            self.end_headers()
            self.wfile.write(answer)

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Answers)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield Authority(folder, f"http://127.0.0.1:{server.server_address[1]}/")
    server.shutdown()
    server.server_close()


@pytest.fixture
def signature(tmp_path: Path) -> Path:
    path = tmp_path / "signature.json"
    path.write_text('{"signature": "of this test"}', encoding="utf-8")
    return path


def test_a_stamp_is_verified_by_its_root_and_by_the_other_program(
    authority: Authority, signature: Path
) -> None:
    before = dt.datetime.now(dt.UTC) - dt.timedelta(seconds=2)
    made = stamp(signature, authority.address)
    assert before <= made.time <= dt.datetime.now(dt.UTC) + dt.timedelta(seconds=2)
    assert "Time of the test" in made.authority
    read = stamped(signature, authority.root)
    assert read is not None
    assert (read.time, read.verified) == (made.time, True)
    unverified = stamped(signature)
    assert unverified is not None
    assert "was not verified" in unverified.text(catalogue("en"))
    asked = (
        "ts",
        "-verify",
        "-in",
        signature.with_name(STAMP),
        "-data",
        signature,
        "-CAfile",
        authority.root,
    )
    _openssl(*asked, folder=authority.folder)


def test_a_changed_signature_has_another_stamp(authority: Authority, signature: Path) -> None:
    stamp(signature, authority.address)
    signature.write_text('{"signature": "of somebody"}', encoding="utf-8")
    with pytest.raises(InputMalformedError, match="of another signature"):
        stamped(signature)


def test_another_root_does_not_verify(authority: Authority, signature: Path, tmp_path: Path) -> None:
    stamp(signature, authority.address)
    certified(tmp_path / "stranger", "A stranger")
    with pytest.raises(InputMalformedError, match="not by one of the authorities"):
        stamped(signature, tmp_path / "stranger" / "ca.pem")


@pytest.mark.parametrize("cut", [0, 1, 40, 300])
def test_a_damaged_stamp_is_refused(authority: Authority, signature: Path, cut: int) -> None:
    stamp(signature, authority.address)
    path = signature.with_name(STAMP)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(InputMalformedError, match="is not a time stamp"):
        stamped(signature)


def test_each_byte_of_a_stamp_counts(authority: Authority, signature: Path) -> None:
    """However a bit is turned: an error, or the same time by the same authority (what is not signed)."""
    made = stamp(signature, authority.address)
    path = signature.with_name(STAMP)
    whole = path.read_bytes()
    for k in range(0, len(whole), 37):
        path.write_bytes(whole[:k] + bytes([whole[k] ^ 0x10]) + whole[k + 1 :])
        try:
            read = stamped(signature, authority.root)
        except InputMalformedError:
            continue
        assert read is not None
        assert read.time == made.time


@pytest.mark.parametrize(
    ("path", "refusal", "match"),
    [("large", InputMalformedError, "too large"), ("page", InputMalformedError, "not a time stamp")],
)
def test_an_authority_that_answers_otherwise(
    authority: Authority, signature: Path, path: str, refusal: type[Exception], match: str
) -> None:
    with pytest.raises(refusal, match=match):
        stamp(signature, authority.address + path)
    assert not signature.with_name(STAMP).exists()


def test_an_old_answer_is_refused(authority: Authority, signature: Path) -> None:
    """What was stamped before is sent again: its nonce is another one."""
    stamp(signature, authority.address)
    signature.with_name(STAMP).unlink()
    with pytest.raises(InputMalformedError, match="time stamp is of other data"):
        stamp(signature, authority.address + "again")


def test_what_cannot_be_asked(signature: Path, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="does not answer"):
        stamp(signature, "http://127.0.0.1:9/")
    with pytest.raises(ConfigurationError, match="not an http or https"):
        stamp(signature, "file:///etc/passwd")
    with pytest.raises(InputNotFoundError, match="no signature"):
        stamp(tmp_path / "missing" / "signature.json", "http://127.0.0.1:9/")
    assert stamped(signature) is None


def test_a_certificate_is_signed_stamped_and_verified(
    authority: Authority, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, photocal: object
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    run, folder = tmp_path / "run", tmp_path / "certificate"
    adjust_block(DEMO, run)

    def said(*arguments: str | Path) -> Answer:
        answer: Answer = photocal(*arguments)  # type: ignore[operator]
        return answer

    assert said("keys", "--new", "Laboratory").code == 0
    assert said("certificate", run, "-o", folder, "--block", DEMO, "--date", "2026-11-21").code == 0
    assert said("sign", folder, "--time-stamp", authority.address).code == 0
    verified = said("verify", folder, "--authorities", authority.root, "--json")
    answer = json.loads(verified.out)
    assert answer["problems"] == []
    assert verified.code == 0
    assert answer["time_stamp"]["verified"] is True
    # A stamp of another signature is no stamp of this one.
    (folder / "signature.json").write_bytes((folder / "signature.json").read_bytes() + b"\n")
    damaged = said("verify", folder, "--json")
    assert damaged.code == 4
    # Where signing is refused the stamp stays with its signature; signed again, it is gone.
    key = tmp_path / "settings" / "photocal" / "key.pem"
    key.chmod(0o644)
    assert said("sign", folder).code != 0
    assert (folder / STAMP).exists()
    key.chmod(0o600)
    assert said("sign", folder).code == 0
    assert not (folder / STAMP).exists()


def test_a_stamp_keeps_what_a_key_signed_before_it_expired(
    authority: Authority,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    photocal: Callable[..., Answer],
    on_day: Callable[[str], None],
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    run, folder = tmp_path / "run", tmp_path / "certificate"
    adjust_block(DEMO, run)
    tomorrow = dt.datetime.now(dt.UTC).date() + dt.timedelta(days=1)
    assert photocal("keys", "--new", "Laboratory", "--expires", tomorrow.isoformat()).code == 0
    assert photocal("certificate", run, "-o", folder, "--block", DEMO, "--date", "2026-11-21").code == 0
    assert photocal("sign", folder, "--time-stamp", authority.address).code == 0
    on_day((tomorrow + dt.timedelta(days=400)).isoformat())
    assert photocal("verify", folder, "--authorities", authority.root).code == 0
    # Whose time nobody has verified proves nothing.
    assert photocal("verify", folder).code == 12
    (folder / STAMP).unlink()
    assert photocal("verify", folder, "--authorities", authority.root).code == 12
