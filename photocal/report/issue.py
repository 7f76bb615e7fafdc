"""Issuing a certificate: its record for programs, HTML page and PDF, with the inputs of them all."""

import datetime as dt
import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from photocal.base.arrays import as_plain, picked
from photocal.base.codec import object_of
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError
from photocal.base.files import output_folder
from photocal.block.model import InputFile
from photocal.block.results.folder import block_of_run, carry, read_json, result_json
from photocal.block.results.result import Figures, Result
from photocal.findings.document import Document, html, pdf
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, finding_json
from photocal.findings.verdict import Verdict, verdict_json
from photocal.report.certificate import certificate, certificate_number, certified, overall
from photocal.report.certificate_metadata import Metadata
from photocal.report.derived_figures import DerivedFigures, derived_figures, verdict
from photocal.report.ministry_rows import Context, entries, read_layout
from photocal.report.sensor import farthest_corner, radial_profile
from photocal.report.signing import keep_signed
from photocal.report.stored_analysis import AnalysedRun, certified_analysis, read_run

SCHEMA = "photocal.certificate/1"
NAME = "certificate.json"
# What a certificate repeats of `result.json`: all but what differs from one computation to the next.
RESULT_KEYS = (
    *("schema", "software", "block", "inputs", "converged", "iterations", "observations", "unknowns"),
    *("degrees_of_freedom", "chi_squared", "sigma0_squared", "global_test", "groups", "cameras", "images"),
    *("checks", "snooping", "mounting", "heads", "lasers", "variance_components"),
)
FORMS = ("certificate.html", "certificate.pdf", NAME)


@dataclass(frozen=True)
class _Asked:
    alpha: Annotated[float, Field(gt=0, lt=1)]
    correlation_threshold: Annotated[float, Field(ge=0, le=1)]
    bootstrap_draws: Annotated[int, Field(ge=0, le=10_000)] = 0


@dataclass(frozen=True)
class _Needed:
    """What a verification needs of a certificate before it computes."""

    number: str
    date: dt.date
    language: str
    particulars: dict[str, Any]
    warnings: tuple[dict[str, Any], ...]
    notes: tuple[dict[str, Any], ...]
    result: Figures
    analysis: _Asked | None
    run_files: tuple[InputFile, ...]
    documents: dict[str, str]


def record(
    run: AnalysedRun, particulars: Metadata, say: Catalogue, warnings: tuple[Finding, ...] = ()
) -> dict[str, Any]:
    """Make the machine-readable certificate; `say`: language of the technical report's texts."""
    result = {key: value for key, value in result_json(run.result).items() if key in RESULT_KEYS}
    known = tuple(derived_figures(run, name, particulars) for name in run.result.cameras)
    return {
        "schema": SCHEMA,
        "number": certificate_number(run, particulars, warnings),
        "verdict": verdict_json(overall(run, known, warnings), say),
        "date": particulars.date.isoformat(),
        "language": say.language,
        "particulars": particulars.model_dump(mode="json", exclude={"date"}),
        "warnings": [finding_json(warning, say) for warning in warnings if warning.severity != "note"],
        "notes": [finding_json(warning, say) for warning in warnings if warning.severity == "note"],
        # Where the block lay is nobody's concern: the certificate carries its inputs.
        "result": {**result, "block": {**result["block"], "source": ""}},
        "exposures": _exposures(run),
        "cameras": {facts.camera_id: _camera(run, facts) for facts in known},
        "technical_reports": {f.camera_id: _report(Context(run, particulars, f, say)) for f in known},
        "analysis": certified_analysis(run.analysis),
        "run_files": as_plain(run.files),
        "documents": {},
    }


def _exposures(run: AnalysedRun) -> list[dict[str, Any]]:
    images = run.result.images
    values = np.hstack([images.station, images.angles_deg])
    sigmas = np.hstack([images.sigma[:, 3:], np.degrees(images.sigma[:, :3])])
    names = ("X_m", "Y_m", "Z_m", "omega_deg", "phi_deg", "kappa_deg")
    return [
        {
            "image": image,
            "camera": images.cameras[camera].id,
            **{n: {"value": v, "sigma": s} for n, v, s in zip(names, value, sigma, strict=True)},
        }
        for image, camera, value, sigma in zip(
            images.names, images.camera, values.tolist(), sigmas.tolist(), strict=True
        )
    ]


def _camera(run: AnalysedRun, known: DerivedFigures) -> dict[str, Any]:
    camera = run.result.cameras[known.camera_id]
    curve = radial_profile(camera, np.linspace(0.0, farthest_corner(camera), 21))
    keys = ("radius", "value", "sigma", "decentring_at_most")
    sigma, whose = run.stated(known.camera_id)
    renamed = {"principal_distance_mm": "focal_mm", "flying_height_m": "height_m", "air_base_m": "base_m"}
    return {
        **picked(known, "pixel_mm", "gsd_cm", **renamed, expected_altimetric_error_cm="dz_cm"),
        "stated": {"value": camera.value("c"), "sigma": sigma, "of": whose},
        "acceptance": {
            "verdict": verdict(known.limits),
            "limits": [{**as_plain(limit), "met": limit.met} for limit in known.limits],
        },
        "findings": [picked(f, "code", "severity", "subject", "figures") for f in known.findings],
        "radial_displacement": {
            "unit": camera.unit,
            "rows": [dict(zip(keys, row, strict=True)) for row in curve.tolist()],
        },
    }


def _report(context: Context) -> list[dict[str, str]]:
    language = context.say.language
    names = {key: key for key in ("section", "item", "key", "unit")} | {"label": language}
    names |= {"value": "value", "origin": "origin"}
    filled = entries(read_layout(), context)
    return [{name: row[column] for name, column in names.items()} for row in filled]


def plain_record(
    run: AnalysedRun, particulars: Metadata, say: Catalogue, warnings: tuple[Finding, ...] = ()
) -> dict[str, Any]:
    """Make the certificate as it comes back from JSON: lists for tuples."""
    content: dict[str, Any] = json.loads(json.dumps(record(run, particulars, say, warnings), allow_nan=False))
    return content


def read_record(path: Path) -> tuple[dict[str, Any], Path]:
    """Read a machine-readable certificate.

    raises InputNotFoundError: when there is none.
    raises InputMalformedError: when it is cut, of another schema, or lacks what a verification needs.
    """
    file = path / NAME if path.is_dir() else path
    if file.is_symlink() or not file.is_file():
        raise InputNotFoundError("no such file", "name certificate.json or its folder", where=file)
    content = read_json(file, SCHEMA, "name the certificate.json of a certificate")
    _complete(content, file)
    return content, file.parent


def certified_result(certificate: dict[str, Any], folder: Path) -> Figures:
    """Give the result of the adjustment that a certificate carries.

    raises InputMalformedError: when it is not complete.
    """
    remedy = "make the certificate again"
    return object_of(Figures, certificate["result"], folder / NAME, remedy, "result")


def _complete(content: dict[str, Any], file: Path) -> None:
    """Refuse what lacks or has otherwise what a verification needs, and inputs outside their folder."""
    needed = object_of(_Needed, content, file, "make the certificate again")
    names = [*(entry.path for entry in needed.result.inputs), *(entry.path for entry in needed.run_files)]
    for name in (*names, needed.result.block.setup):
        # A certificate comes from elsewhere: it may not reach outside the folder of its inputs.
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name:
            raise InputMalformedError(
                f"input {name!r} lies outside the folder of the inputs",
                "make the certificate again",
                where=file,
            )


def issue(
    run: Path,
    output: Path,
    particulars: Metadata,
    *,
    language: str = "en",
    block: Path | None = None,
    warnings: tuple[Finding, ...] = (),
    done: Callable[[], None] = lambda: None,
    judged: Callable[[Verdict], None] = lambda _: None,
) -> Document:
    """Write the certificate of a run; a signed one that lies there is kept beside it, under its number.

    block: block folder or set-up file of the run; looked for near it when not given. Its files are carried.
    judged: gets the verdict before anything is drawn.
    raises PhotocalError: for inputs that cannot be read or have changed, and for figures that cannot be
        right.
    """
    say = catalogue(language)
    results = read_run(run)
    _refuse_a_guess(run, results.result)
    try:
        source = block_of_run(run, results.result, block, Path.cwd())
    except InputNotFoundError:
        source = None
    judged(certified(results, particulars, say, warnings))
    done()
    document = certificate(results, particulars, say, warnings)
    done()
    forms = printed(document, particulars.date)
    done()
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in forms.items()}
    content = {**record(results, particulars, say, warnings), "documents": digests}
    forms[NAME] = (json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()
    done()
    keep_signed(output, forms[NAME])
    with output_folder(output) as folder:
        for name, octets in forms.items():
            (folder / name).write_bytes(octets)
        if source is not None:
            carry(results.result.inputs, source, folder)
    return document


def printed(document: Document, day: dt.date) -> dict[str, bytes]:
    """Print a certificate: HTML page and PDF by the names of their files."""
    return {FORMS[0]: html(document).encode(), FORMS[1]: pdf(document, day)}


def _refuse_a_guess(run: Path, result: Result) -> None:
    """Refuse cameras whose c was neither given nor estimated; older runs do not say it."""
    guessed = [name for name, camera in result.cameras.items() if camera.guessed]
    if guessed:
        raise ConfigurationError(
            f"the principal distance of camera {guessed[0]} is a guess that was held",
            "give its calibrated value and remove guessed = true, or name c under estimate; where it"
            " is there already, this flight does not determine it: fly two heights, with crossed strips",
            where=run,
        )
