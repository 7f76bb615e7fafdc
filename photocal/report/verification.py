"""Whether every figure of a certificate is what its inputs give: comparison of two certificates."""

import datetime as dt
import json
import math
import re
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

from photocal.analysis.analyse_run import analyse_run
from photocal.base.files import digest
from photocal.block.model import InputFile
from photocal.block.options import Wanted
from photocal.block.results.adjusted import adjust_block
from photocal.block.results.folder import CARRIED, RESULT, BlockSource, carry
from photocal.exchange.formats import read_any_block
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, findings_of
from photocal.report.certificate import certificate
from photocal.report.certificate_metadata import Metadata, given_particulars
from photocal.report.issue import FORMS, NAME, certified_result, plain_record, printed
from photocal.report.signing import SIGNATURE, STAMP
from photocal.report.stored_analysis import AnalysedRun, read_run

PAGES = FORMS[:2]
# The pages are compared themselves.
NOT_FIGURES = ("documents",)
_DRAWN = re.compile(rb"<svg.*?</svg>", re.DOTALL)
_NUMBER = re.compile(rb"(?<![\w#])-?\d+\.\d+")
# A number may differ by this share of itself, or, in metres, pixels and correlations, by this much.
RELATIVE, ABSOLUTE = 1e-6, 1e-8
# Adjustments without a parameter end within a hundredth of a standard deviation of their minimum, on another
# machine perhaps on its other side: apart by this share of their standard deviation, or of what exceeds it.
LEFT_OUT = 0.02
# Other figures of the analysis are differences of two adjustments, each of which ends within a millionth of a
# standard deviation of its minimum: four digits of them are the same everywhere;
ANALYSIS, ANALYSIS_RELATIVE = "analysis", 1e-4
# those that may be nearly zero, in millimetres, metres, pixels or as correlations, to a millionth.
NEARLY_ZERO = ("c", "change_of_c", "value", "check_rmse_m", "shift_c", "bias", "ground_m", "effect_c")


@dataclass(frozen=True)
class Difference:
    """A figure that does not come out as certified: where in the certificate, and both values."""

    place: str
    certified: Any
    found: Any


def changed_files(certificate: dict[str, Any], folder: Path) -> list[str]:
    """Name what lies in a certificate's folder and is not the certificate's, and what it lacks.

    Nothing is read beyond the folder: links are named, not followed. The inputs are for `changed_inputs`.
    """
    carried = (f"{CARRIED}/{entry['path']}" for entry in certificate["result"]["inputs"])
    expected = {NAME, SIGNATURE, STAMP, *PAGES, *carried}
    folders = {parent.as_posix() for name in expected for parent in PurePosixPath(name).parents}
    named = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            named.append(f"{name} is a link")
        elif name not in (folders if path.is_dir() else expected):
            named.append(f"{name} is not part of the certificate")
    documents = certificate["documents"]
    named += [f"{name} is not a document of a certificate" for name in sorted(documents.keys() - set(PAGES))]
    for name in PAGES:
        path = folder / name
        if name not in documents:
            named.append(f"{name} is not among the documents")
        elif not path.is_file():
            named.append(f"{name} is missing")
        elif not path.is_symlink() and digest(path) != documents[name]:
            named.append(f"{name} is not the one that was certified")
    return named


def changed_pages(folder: Path, pages: Mapping[str, bytes]) -> list[str]:
    """Name the pages of a certificate that do not say what its figures give."""
    return [
        f"{name} does not agree with the figures"
        for name, printed in pages.items()
        if not _same_page((folder / name).read_bytes(), printed)
    ]


def _same_page(certified: bytes, printed: bytes) -> bool:
    """Whether two pages are the same but for the last digits of what is drawn."""
    if certified == printed:
        return True
    first, second = _drawings(certified), _drawings(printed)
    # A line may be drawn by this part of a point elsewhere.
    drawn = 0.02
    return (
        _NUMBER.split(first) == _NUMBER.split(second)
        and len(_DRAWN.findall(certified)) == len(_DRAWN.findall(printed))
        and all(
            abs(float(a) - float(b)) <= drawn
            for a, b in zip(_NUMBER.findall(first), _NUMBER.findall(second), strict=True)
        )
        and _DRAWN.sub(b"", certified) == _DRAWN.sub(b"", printed)
    )


def _drawings(page: bytes) -> bytes:
    return b"\0".join(_DRAWN.findall(page))


def differences(certified: Any, recomputed: Any, place: str = "", sigma: float = 0.0) -> list[Difference]:
    """Compare two certificates figure by figure."""
    if isinstance(certified, dict) and isinstance(recomputed, dict):
        return _in_mappings(certified, recomputed, place)
    if isinstance(certified, list) and isinstance(recomputed, list) and len(certified) == len(recomputed):
        pairs = enumerate(zip(certified, recomputed, strict=True))
        return [d for i, (a, b) in pairs for d in differences(a, b, f"{place}[{_name(a, i)}]")]
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in (certified, recomputed)):
        same = abs(certified - recomputed) <= _tolerance(place, max(abs(certified), abs(recomputed)), sigma)
    else:
        same = certified == recomputed
    return [] if same else [Difference(place, certified, recomputed)]


def _in_mappings(certified: dict[str, Any], recomputed: dict[str, Any], place: str) -> list[Difference]:
    missing = object()
    listed = []
    sigma = certified.get("sigma")
    for key in dict.fromkeys([*certified, *recomputed]):
        if key in NOT_FIGURES:
            continue
        a, b = certified.get(key, missing), recomputed.get(key, missing)
        where = f"{place}.{key}" if place else key
        if a is missing or b is missing:
            listed.append(Difference(where, *(None if value is missing else value for value in (a, b))))
            continue
        if key == "left_out":
            listed += _left_out(a, b, where, _sigma_of_c(certified))
            continue
        spread = float(sigma) if key == "value" and isinstance(sigma, int | float) else 0.0
        listed += differences(a, b, where, spread)
    return listed


def _sigma_of_c(camera: dict[str, Any]) -> float:
    """Standard deviation of c of an analysed camera, by the test of c against zero; 0 without one."""
    for test in camera.get("significance", ()):
        if test["parameters"] == ["c"] and test["statistic"] > 0.0 and camera["left_out"]:
            first = camera["left_out"][0]
            return abs(float(first["c"] - first["change_of_c"])) / math.sqrt(test["statistic"])
    return 0.0


def _left_out(certified: Any, recomputed: Any, place: str, sigma: float) -> list[Difference]:
    """Compare adjustments without a parameter: only what lies farther apart than where they end."""
    share = {"c": LEFT_OUT * sigma, "change_of_c": LEFT_OUT * sigma}
    near = []
    for one in differences(certified, recomputed, place):
        _, _, key = one.place.rpartition(".")
        key = key.partition("[")[0]
        numbers = [value for value in (one.certified, one.found) if isinstance(value, float)]
        if len(numbers) == 2:
            allowed = LEFT_OUT * max(map(abs, numbers)) if key == "check_rmse_m" else share.get(key, 0.0)
            if abs(numbers[0] - numbers[1]) <= allowed:
                continue
        near.append(one)
    return near


def _name(item: Any, index: int) -> str:
    """An entry of a list by what it is called, if it is."""
    if isinstance(item, dict):
        for key in ("image", "path", "point", "key", "name", "kind", "method", "code"):
            if isinstance(item.get(key), str):
                return str(item[key])
    return str(index)


def _tolerance(place: str, size: float, sigma: float) -> float:
    """By how much two computations of a figure may differ."""
    # Two machines sum in another order; a value may differ by this share of its standard deviation.
    share_of_sigma = 1e-4
    if sigma > 0.0:
        return max(share_of_sigma * sigma, 1e-12 * size)
    key = place.rsplit(".", 1)[-1].split("[")[0]
    if key == "iterations":
        # An iteration may be needed more or less.
        return 2
    # Of what may be nearly zero.
    absolute = 1e-6
    if place.startswith(ANALYSIS):
        return max(ANALYSIS_RELATIVE * size, absolute if key in NEARLY_ZERO else 0.0)
    # Coefficients may be as small as 1e-20: only figures of known size have an absolute tolerance.
    known = key not in ("sigma", "value", "prior_sigma")
    return max(RELATIVE * size, ABSOLUTE if known else 0.0)


def repeated(
    certified: dict[str, Any], folder: Path, source: BlockSource, done: Callable[[], None] = lambda: None
) -> AnalysedRun:
    """Adjust and analyse the certified inputs anew, as the certificate says that it was done.

    raises PhotocalError: as reading and adjusting do.
    """
    result = certified_result(certified, folder)
    with tempfile.TemporaryDirectory(prefix="photocal-verify-") as name:
        aside = Path(name)
        # Only what is certified is used, whatever else is in the folder.
        carry(result.inputs, source, aside)
        copied = BlockSource(aside / CARRIED, result.block.setup)
        wanted = Wanted(components=bool(result.variance_components))
        adjust_block(copied.path, aside / "run", result.snooping, wanted=wanted, read=read_any_block)
        done()
        analysis = certified.get("analysis")
        if analysis is not None:
            asked = analysis["alpha"], analysis["correlation_threshold"]
            draws = analysis.get("bootstrap_draws", 0)
            analyse_run(
                aside / "run", copied.path, *asked, lambda _: done(), draws=draws, read=read_any_block
            )
        return read_run(aside / "run")


def as_certified(run: AnalysedRun, certified: dict[str, Any], folder: Path) -> AnalysedRun:
    """Give a repeated run what no repetition can know: its block's name, the digests of the first run."""
    block = replace(run.result.block, name=certified_result(certified, folder).block.name)
    files = tuple(InputFile(**entry) for entry in certified["run_files"])
    first = next((file.sha256 for file in files if file.path == RESULT), "")
    analysis = None if run.analysis is None else replace(run.analysis, result_sha256=first)
    return replace(run, result=replace(run.result, block=block), files=files, analysis=analysis)


def record_of(run: AnalysedRun, certified: dict[str, Any]) -> dict[str, Any]:
    """Make the certificate of a repeated run, comparable by `verification.differences`."""
    return plain_record(run, *given_by(certified))


def pages_of(run: AnalysedRun, certified: dict[str, Any]) -> dict[str, bytes]:
    """Print the certificate of a repeated run."""
    return printed(certificate(run, *given_by(certified)), dt.date.fromisoformat(certified["date"]))


def given_by(certified: dict[str, Any]) -> tuple[Metadata, Catalogue, tuple[Finding, ...]]:
    """What a certificate was made of beside the run: particulars, language, warnings and notes."""
    particulars = given_particulars(certified["particulars"], certified["date"])
    warnings = findings_of([*certified["warnings"], *certified["notes"]], "certificate.json")
    return particulars, catalogue(certified["language"]), warnings


def stated_by_issuer(certified: dict[str, Any]) -> list[str]:
    """Name everything in a certificate that no repetition can tell: what the issuer typed or measured."""
    stated = [f"date {certified['date']}", f"language {certified['language']}"]
    for section, keys in certified["particulars"].items():
        entries = keys if isinstance(keys, dict) else {"": keys}
        for key, value in entries.items():
            if value not in (None, "", [], {}):
                stated.append(f"{section}{'.' * bool(key)}{key} {_shown(value)}")
    return [*stated, *_choices(certified)]


def _choices(certified: dict[str, Any]) -> list[str]:
    """How the issuer has adjusted and tested: repeated so, though another choice may find more."""
    result, analysis = certified["result"], certified.get("analysis")
    chosen = [f"data snooping {result['snooping']}"] if result.get("snooping") else []
    if result.get("variance_components"):
        chosen.append("sigmas estimated: variance components")
    if analysis is None:
        return [*chosen, "no analysis: hidden errors were not searched for"]
    keys = ("alpha", "correlation_threshold", "bootstrap_draws")
    return [*chosen, *(f"analysis.{key} {_shown(analysis[key])}" for key in keys if analysis.get(key))]


def _shown(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    # Longer texts are cut, to keep a difference one line.
    longest_shown = 60
    return text if len(text) <= longest_shown else f"{text[:longest_shown]}..."
