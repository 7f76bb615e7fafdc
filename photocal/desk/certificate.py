"""Answers to the step Certificate: particulars, preview, signature, what is sent, and a check of others.

What only people know of a certificate, as a form: its fields, their values, and the file they stand in.
"""

import datetime as dt
import json
import tempfile
import zipfile
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any

import tomlkit
from pydantic import Field
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Route

from photocal.base.archives import DAMAGES
from photocal.base.checked_toml import Table
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError, PhotocalError
from photocal.base.files import output_file
from photocal.base.web import calling, checked, doing, short_body, telling
from photocal.block.project import Project
from photocal.block.results.folder import RESULT
from photocal.desk import project_file
from photocal.desk.folder import pictures
from photocal.desk.jobs import asked
from photocal.desk.session import Desk
from photocal.findings.texts import catalogue
from photocal.findings.verdict import read_verdict, verdict_text
from photocal.report.certificate_metadata import Form, read_particulars
from photocal.report.keys import own_key
from photocal.report.signing import SIGNATURE
from photocal.run.stage import made_in

if TYPE_CHECKING:
    from photocal.report.stored_analysis import AnalysedRun

NAME = "particulars.toml"
# Sections and keys of the form, in its order; the file may have more, which stay.
FORM = {
    "document": ("place", "comments"),
    "camera": ("model", "manufacturer", "serial", "lens_type", "lens_serial"),
    "campaign": ("method", "test_field", "platform"),
    "conditions": (
        *("temperature_c", "relative_humidity_percent", "pressure_hpa", "focus", "aperture"),
        *("stabilisation", "firmware", "in_camera_correction", "state"),
    ),
    "validity": ("until", "conditions"),
    "responsible": ("name", "title", "registration"),
    "laboratory": ("name", "address", "traceability"),
}
_NUMBERS = ("temperature_c", "relative_humidity_percent", "pressure_hpa")
_DAYS = ("until",)


def fields(path: Path | None, told: Mapping[str, Mapping[str, str | float]]) -> list[dict[str, Any]]:
    """Every field with what was typed, and with what the pictures say where nothing was."""
    typed = _typed(path).unwrap()
    return [
        {
            "key": f"{section}.{key}",
            "section": section,
            "kind": "number" if key in _NUMBERS else "date" if key in _DAYS else "text",
            "value": _shown(typed.get(section, {}).get(key)),
            "told": _shown(told.get(section, {}).get(key)),
        }
        for section, keys in FORM.items()
        for key in keys
    ]


def _shown(value: Any) -> str:
    return "" if value is None else str(value)


def _typed(path: Path | None) -> tomlkit.TOMLDocument:
    there = path is not None and path.is_file()
    return tomlkit.parse(path.read_text(encoding="utf-8-sig")) if there and path else tomlkit.document()


def written(path: Path | None, given: Mapping[str, str]) -> str:
    """Text of the file with the values of the form: empty ones are taken out, all others and comments stay.

    raises ConfigurationError: for a key that is none of the form, and for what is no number or no day.
    """
    document = _typed(path)
    for name, text in given.items():
        section, _, key = name.partition(".")
        if key not in FORM.get(section, ()):
            raise ConfigurationError(f"{name} is not a particular of the form", "use the page")
        if section not in document:
            if not text.strip():
                continue
            document[section] = tomlkit.table()
        table: Any = document[section]
        if not text.strip():
            table.pop(key, None)
        else:
            table[key] = _value(name, key, text.strip())
    return tomlkit.dumps(document)


def _value(name: str, key: str, text: str) -> Any:
    try:
        if key in _NUMBERS:
            return float(text.replace(",", "."))
        if key in _DAYS:
            return dt.date.fromisoformat(text)
    except ValueError:
        form = "a number" if key in _NUMBERS else "a day, such as 2027-05-31"
        raise ConfigurationError(f"{name} = {text!r} is not {form}", "correct it") from None
    return text


def write(path: Path, text: str, day: dt.date) -> None:
    """Write the file, when the whole of it can be read; raises ConfigurationError otherwise."""
    with output_file(path) as aside:
        aside.write_text(text, encoding="utf-8", newline="\n")
        read_particulars(aside, day)


# A document within the page: no script, no network, nothing but itself.
_FRAMED = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'self'; sandbox"
)
_LONGEST_ZIP, _MOST_FILES, _LONGEST_FILES = 400 << 20, 5000, 2 << 30
_RECORD, _PAGE = "certificate.json", "certificate.html"
_KEYS = ("client", "operator", "form", "language")
Short = Annotated[str, Field(max_length=2000)]


class Typed(Table, strict=True):
    """The form as it stands in the page: what was typed, by section and key, and the keys of the project."""

    values: dict[str, Short]
    client: Short = ""
    operator: Short = ""
    form: Form = ""
    language: str = "en"


def routes(desk: Desk) -> list[BaseRoute]:
    """Return what answers for the step Certificate."""

    async def framed(_: Request) -> Response:
        """Answer with the document that was previewed last, or with the one that was issued."""
        text = await run_in_threadpool(lambda: desk.preview or issued(desk))
        return HTMLResponse(text, headers={"content-security-policy": _FRAMED})

    async def packed(_: Request) -> Response:
        """Answer with the whole certificate in one file."""
        path, name = await run_in_threadpool(pack, desk)
        return FileResponse(path, filename=name, background=BackgroundTask(path.unlink, missing_ok=True))

    async def verified(request: Request) -> Response:
        """Answer what another certificate is worth."""
        if request.headers.get("content-type") != "application/zip":
            raise ConfigurationError("is not a zip of a certificate", "drop the zip that was sent")
        sent = await short_body(request, _LONGEST_ZIP)
        return JSONResponse(await run_in_threadpool(verify, sent, desk.language))

    return [
        telling("/api/certificate", lambda: state(desk)),
        doing("/api/certificate/set", lambda body: _set(desk, checked(Typed, body))),
        doing("/api/certificate/preview", lambda body: _preview(desk, checked(Typed, body))),
        doing("/api/certificate/sign", calling(_sign, desk)),
        doing("/api/certificate/key", calling(_key, desk)),
        doing("/api/certificate/verify", lambda _: verified_folder(_place(desk), desk.language)),
        Route("/certificate/preview", framed),
        Route("/certificate/zip", packed),
        Route("/api/verify", verified, methods=["POST"]),
    ]


def state(desk: Desk) -> dict[str, Any]:
    """The certificate as it lies there, its form, and the key."""
    from photocal.measurement.picture_tests import told_conditions

    project, key = desk.project(), own_key()
    given = project.contents.certificate
    folder = project.output / "certificate"
    return {
        "ready": (made_in(project.output) / "analysis" / RESULT).is_file(),
        "fields": fields(given.particulars, told_conditions(pictures(desk))),
        "file": desk.named(_file(desk, project)),
        **given.model_dump(include={*_KEYS}),
        # The page's, until one is chosen.
        "language": given.language or desk.language,
        "key": None if key is None else {"name": key.name, "fingerprint": key.fingerprint},
        "issued": issued_as(folder, desk.language),
        "lines": {
            "issue": desk.line(["run", desk.folder]),
            "sign": desk.line(["sign", folder]),
            "key": desk.line(["keys", "--new", "NAME"]),
            "verify": desk.line(["verify", folder]),
        },
    }


def issued_as(folder: Path, language: str = "en") -> dict[str, Any] | None:
    """Number, day and verdict of a certificate that lies in a folder, and whether it is signed.

    language: of the verdict's words; the certificate has a language of its own.
    """
    try:
        content = json.loads((folder / _RECORD).read_bytes())
        final = read_verdict(content["verdict"], folder)
        paragraph, *lines = verdict_text(final, catalogue(language))
        verdict = {"severity": final.outcome.severity, "paragraph": paragraph, "said": lines}
        named = {"number": content["number"], "date": content["date"], "verdict": verdict}
    except (OSError, ValueError, LookupError, TypeError, PhotocalError):
        return None
    return {**named, "folder": str(folder), "signed": (folder / SIGNATURE).is_file()}


def _place(desk: Desk) -> Path:
    return desk.project().output / "certificate"


def _file(desk: Desk, project: Project) -> Path:
    return project.contents.certificate.particulars or desk.folder / NAME


def _set(desk: Desk, typed: Typed) -> dict[str, Any]:
    """Write the form into the particulars and the project."""
    with desk.lock:
        project = desk.project()
        path = _file(desk, project)
        text = written(path, typed.values)
        if text.strip() or path.is_file():
            write(path, text, _today())
            if project.contents.certificate.particulars is None:
                project_file.put(desk.file, "certificate.particulars", NAME)
        for key, value in typed.model_dump(include={*_KEYS}).items():
            if value != getattr(project.contents.certificate, key):
                project_file.put(desk.file, f"certificate.{key}", value)
    return state(desk)


def _today() -> dt.date:
    return dt.datetime.now().astimezone().date()


def _preview(desk: Desk, typed: Typed) -> dict[str, Any]:
    """Make the certificate of a form that is not kept yet, without writing anything of the project."""
    # What computes is loaded when it is needed: the window is there at once.
    from photocal.findings.document import html
    from photocal.measurement.picture_tests import told_conditions
    from photocal.report.certificate import certificate
    from photocal.run.summary import gather, read_json

    project = desk.project()
    work, key = made_in(project.output), own_key()
    run = _analysed(work / "analysis")
    text = written(_file(desk, project), typed.values)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / NAME
        path.write_text(text or "# nothing was typed\n", encoding="utf-8")
        given = read_particulars(
            path,
            _today(),
            client=typed.client,
            operator=typed.operator,
            form=typed.form,
            key="" if key is None else key.fingerprint,
            pictures=told_conditions(pictures(desk)),
            flown=read_json(work / "flown" / "flown.json"),
        )
    document = certificate(run, given, catalogue(typed.language), gather(work))
    desk.preview = html(document)
    return {"number": document.number}


def _analysed(folder: Path) -> "AnalysedRun":
    try:
        return _run(folder, (folder / RESULT).stat().st_mtime_ns)
    except OSError:
        raise InputNotFoundError("there is no result yet", "run the project first", where=folder) from None


@lru_cache(maxsize=1)
def _run(folder: Path, _changed: int) -> "AnalysedRun":
    from photocal.report.stored_analysis import read_run

    return read_run(folder)


def issued(desk: Desk) -> str:
    """The certificate as it was issued last; raises InputNotFoundError without one."""
    path = _place(desk) / _PAGE
    if not path.is_file():
        raise InputNotFoundError("no certificate is issued yet", "run the project first", where=desk.folder)
    return path.read_text(encoding="utf-8")


def _sign(desk: Desk, passphrase: Short = "") -> dict[str, Any]:
    # What is secret stands in no list of processes.
    asked(["sign", _place(desk)], {"PHOTOCAL_PASSPHRASE": passphrase})
    return state(desk)


def _key(
    desk: Desk, name: Annotated[str, Field(min_length=1, max_length=100)], passphrase: Short = ""
) -> dict[str, Any]:
    asked(["keys", "--new", name], {"PHOTOCAL_PASSPHRASE": passphrase})
    return state(desk)


def pack(desk: Desk) -> tuple[Path, str]:
    """Pack the certificate as it lies there; gives a file that somebody must remove, and its name."""
    folder = _place(desk)
    record = issued_as(folder)
    if record is None:
        raise InputNotFoundError("no certificate is issued yet", "run the project first", where=folder)
    with tempfile.NamedTemporaryFile(suffix=".zip", delete=False) as file:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(folder.rglob("*")):
                if path.is_file() and not path.is_symlink():
                    archive.write(path, path.relative_to(folder).as_posix())
        name = "".join(c if c.isalnum() or c in "-_." else "-" for c in str(record["number"]))
        return Path(file.name), f"certificate-{name}.zip"


def verify(octets: bytes, language: str = "en") -> dict[str, Any]:
    """Unpack a certificate aside and verify it; nothing of it stays.

    raises InputMalformedError: for what is not a zip of a certificate, or unpacks to more than any is.
    """
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "sent.zip"
        archive.write_bytes(octets)
        unpacked = Path(folder) / "certificate"
        try:
            with zipfile.ZipFile(archive) as packed:
                _unpack(packed, unpacked)
        except DAMAGES as refusal:
            raise InputMalformedError(f"is not a zip ({refusal})", "drop the zip that was sent") from refusal
        found = sorted(unpacked.rglob(_RECORD), key=lambda path: len(path.parts))
        if not found:
            raise InputMalformedError("has no certificate.json", "drop the zip of a certificate")
        return verified_folder(found[0].parent, language)


def _unpack(packed: zipfile.ZipFile, folder: Path) -> None:
    """Unpack files with names that stay inside, no more of them and no longer than a certificate has."""
    members = [member for member in packed.infolist() if not member.is_dir()]
    if len(members) > _MOST_FILES or sum(member.file_size for member in members) > _LONGEST_FILES:
        raise InputMalformedError("is larger unpacked than a certificate can be", "ask the issuer for it")
    for member in members:
        path = PurePosixPath(member.filename)
        if path.is_absolute() or ".." in path.parts or "\\" in member.filename or ":" in member.filename:
            raise InputMalformedError("has a file outside of its folder", "ask the issuer for it")
        packed.extract(member, folder)


def verified_folder(folder: Path, language: str = "en") -> dict[str, Any]:
    """What `photocal verify` says of a folder, its sentences in a language."""
    told, say = asked(["verify", folder]), catalogue(language)
    keys = ("number", "verified", "reproducible", "authentic", "signature", "problems", "not_told", "verdict")
    return {key: told.get(key) for key in keys} | {"problems": [*map(say.stored, told["problems"])]}
