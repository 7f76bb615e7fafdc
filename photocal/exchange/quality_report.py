"""Quality reports of other programs, read where they lie: what they say of a block, to be set beside ours.

Pix4D writes `NAME_report.pdf`, `.html` and `.xml` beside `params`, Metashape a PDF that its user names, ODM
`report.pdf` and `stats.json`; COLMAP's model_analyzer and MicMac's Campari print theirs, which people keep as
text. Tables are recognised by their heads and captions: pages and their layout change with each version.
Sources: real reports of ODM 3.5; logs of MicMac as its users publish them; the program text of COLMAP's
analyser; for Pix4D's XML and Metashape's PDF what published readers of them expect: no real one was at hand.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from html.parser import HTMLParser
from itertools import islice
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from photocal.base.errors import InputMalformedError, PhotocalError
from photocal.exchange.source import printed, read_json, read_text, read_xml, structured

Triple = tuple[float, float, float]
NOT_SAID: Triple = (math.nan, math.nan, math.nan)
SUFFIXES = (".pdf", ".html", ".htm", ".xml", ".txt", ".json", ".log")
# Larger files, longer documents and deeper folders are no report.
MAX_BYTES, MAX_PAGES, MAX_LINE, DEPTH, MAX_FILES = 64 << 20, 80, 2000, 3, 4000
_NUMBER = r"([-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)"
_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048}
_FOLDERS = ("report", "reports", "odm_report")
_BREAKS = {"br", "div", "h1", "h2", "h3", "h4", "h5", "h6", "li", "p", "table", "tr"}


@dataclass(frozen=True)
class QualityReport:
    """What a report says; NaN where it is silent.

    reprojection_px: of `kind`, the mean length of the residuals or their rms.
    images, calibrated: how many there were, and how many have an orientation.
    control_m, check_m, position_m: rms of adjusted minus given coordinates, X, Y, Z.
    checks: names of the check points.
    camera_sigma_px: of c, x0 and y0, in the order of the cameras.
    """

    program: str
    file: Path
    reprojection_px: float = math.nan
    kind: str = "mean"
    images: int = 0
    calibrated: int = 0
    control_m: Triple = NOT_SAID
    check_m: Triple = NOT_SAID
    position_m: Triple = NOT_SAID
    checks: tuple[str, ...] = ()
    camera_sigma_px: tuple[dict[str, float], ...] = field(default_factory=tuple)


def reports_near(folder: Path) -> list[Path]:
    """Files named as reports are, in a folder, and in one for reports beside it."""
    # Pix4D: 1_initial/params and 1_initial/report; ODM: opensfm and odm_report. Whatever else lies above a
    # project is of others.
    beside = (place for place in _inside(folder.parent) if place.name.casefold() in _FOLDERS)
    roots = (folder, *(place for place in beside if place.is_dir() and place != folder))
    found = dict.fromkeys(path for root in roots for path in _files(root, DEPTH))
    order = {suffix: k for k, suffix in enumerate((".json", ".xml", ".html", ".htm", ".txt", ".log", ".pdf"))}
    return sorted(found, key=lambda path: (order[path.suffix.lower()], len(path.parts), path.name))


def _files(root: Path, depth: int) -> Iterator[Path]:
    for path in _inside(root):
        if path.is_dir() and depth:
            yield from _files(path, depth - 1)
        elif path.suffix.lower() in SUFFIXES and path.is_file():
            name = path.name.casefold()
            if "report" in name or name in ("stats.json", "campari.log", "model_analyzer.txt"):
                yield path


def _inside(folder: Path) -> list[Path]:
    """Files and folders in a folder that may be looked into."""
    try:
        return sorted(path for path in islice(folder.iterdir(), MAX_FILES) if not path.name.startswith("."))
    except OSError:
        # What lies above a project may belong to others.
        return []


def read_quality_report(path: Path) -> QualityReport | None:
    """Read a report; None for a file that is none of a known program.

    raises InputMalformedError: for one that cannot be read.
    """
    if path.stat().st_size > MAX_BYTES:
        raise InputMalformedError(
            f"is larger than the {MAX_BYTES >> 20} MiB allowed for a report", "is it a report?", where=path
        )
    kind = path.suffix.lower()
    if kind == ".json":
        return _of_statistics(path)
    if kind == ".xml":
        return _of_pix4d_xml(path)
    lines = _lines_of(path, kind)
    text = "\n".join(lines)
    for mark, read in _PROGRAMS.items():
        if re.search(mark, text, re.IGNORECASE):
            return read(path, lines, text)
    return None


def report_of(folder: Path, fits: Callable[[str], bool]) -> tuple[QualityReport | None, list[str]]:
    """The first report of a program near a folder, and which ones cannot be read."""
    refusals = list[str]()
    for path in reports_near(folder):
        try:
            report = read_quality_report(path)
        except PhotocalError as refusal:
            refusals.append(f"report {path.name} cannot be read: {refusal.what}")
            continue
        if report is not None and fits(report.program):
            return report, refusals
    return None, refusals


def _lines_of(path: Path, kind: str) -> list[str]:
    if kind == ".pdf":
        text = _text_of_pdf(path)
    elif kind in (".html", ".htm"):
        parser = _Cells()
        parser.feed(read_text(path))
        text = "".join(parser.parts)
    else:
        text = read_text(path)
    return [" ".join(line[:MAX_LINE].split()) for line in text.split("\n") if line.strip()]


def _text_of_pdf(path: Path) -> str:
    import logging

    from pypdf import PdfReader

    # What is wrong with a document is said once, by the refusal.
    logging.getLogger("pypdf").setLevel(logging.CRITICAL)
    try:
        with path.open("rb") as stream:
            pages = PdfReader(stream).pages
            return "\n".join(pages[k].extract_text() for k in range(min(len(pages), MAX_PAGES)))
    except Exception as failure:
        # A damaged document makes its reader raise whatever its structure leads to.
        raise InputMalformedError(
            f"is not a readable PDF ({type(failure).__name__}: {str(failure)[:80]})",
            "open it in a PDF program and save it again",
            where=path,
        ) from failure


class _Cells(HTMLParser):
    """Text of a page: a line for each row of a table, blanks between its cells."""

    def __init__(self) -> None:
        super().__init__()
        self.parts, self._hidden = list[str](), 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:  # noqa: ARG002
        """Begin a row or a cell."""
        self._hidden += tag in ("script", "style")
        self.parts.append("\n" if tag in _BREAKS else " ")

    def handle_endtag(self, tag: str) -> None:
        """End a row or a cell."""
        self._hidden -= tag in ("script", "style") and self._hidden > 0
        self.parts.append("\n" if tag in _BREAKS else " ")

    def handle_data(self, data: str) -> None:
        """Take the text of a cell."""
        if not self._hidden:
            self.parts.append(" ".join(data.split()) if data.strip() else " ")


def _number_after(label: str, text: str) -> float:
    found = re.search(label + r"\s*:?\s*" + _NUMBER, text, re.IGNORECASE)
    return float(found[1]) if found else math.nan


def _count(label: str, text: str) -> int:
    """A whole number after a label; 0 without."""
    value = _number_after(label, text.replace(",", ""))
    return int(value) if math.isfinite(value) else 0


def _pair(pattern: str, text: str) -> tuple[int, int]:
    """Whole numbers of a pattern; zeros without."""
    found = re.search(pattern, text, re.IGNORECASE)
    return (int(found[1]), int(found[2])) if found else (0, 0)


def _three(line: str, factor: float = 1.0) -> Triple:
    values = [float(value) * factor for value in re.findall(_NUMBER, line)][:3]
    return (values[0], values[1], values[2]) if len(values) == 3 else NOT_SAID


# A name, its accuracy, three errors, that in the images, and how many of its marks are verified.
_PIX4D_ROW = re.compile(
    rf"^(.+?)(?: ?\((?:2D|3D|\dD\+?)\))? {_NUMBER} ?/ ?{_NUMBER} {_NUMBER} {_NUMBER} {_NUMBER} .*\d+ ?/ ?\d+$"
)


def _of_pix4d(path: Path, lines: list[str], text: str) -> QualityReport:
    rms: dict[str, Triple] = {}
    role, checks, sigmas = "", list[str](), list[dict[str, float]]()
    for line in lines:
        if re.search(r"(GCP|Control Point) Name", line):
            role = "control"
        elif re.search(r"Check Point Name", line, re.IGNORECASE):
            role = "check"
        elif role and line.startswith("RMS Error"):
            rms[role] = _three(line.split("]", 1)[-1])
            role = ""
        elif role == "check" and (row := _PIX4D_ROW.match(line)):
            checks.append(row[1].strip())
        elif line.startswith("Uncertainties (Sigma)"):
            pixels = [float(value) for value in re.findall(_NUMBER + r" ?\[pixel\]", line)]
            sigmas.append(dict(zip(("c", "x0", "y0"), pixels, strict=False)))
    calibrated, images = _pair(r"(\d+) out of (\d+) images calibrated", text)
    mean = _number_after(r"Mean Reprojection Error \[pixels?\]", text)
    control, check = (rms.get(role, NOT_SAID) for role in ("control", "check"))
    return QualityReport(
        "Pix4D", path, mean, "mean", images, calibrated, control, check,
        checks=tuple(checks), camera_sigma_px=tuple(sigmas),
    )  # fmt: skip


def _of_pix4d_xml(path: Path) -> QualityReport | None:
    root = read_xml(path)
    first = root.find("results/initial")
    if root.tag != "report" or first is None:
        return None

    def rms(kind: str) -> Triple:
        """Read the rms of the points of a kind."""
        element = first.find(f"statsControlPoints/{kind}/rms")
        return NOT_SAID if element is None else _xyz(element)

    def whole(place: str, name: str) -> int:
        """Read a count."""
        element = first.find(place)
        value = printed(None if element is None else element.get(name))
        return int(value) if math.isfinite(value) else 0

    points = first.iterfind("statsControlPoints/checkPoints/inliers/*")
    outer = first.iterfind("statsControlPoints/checkPoints/outliers/*")
    atps = first.find("atps")
    sigmas = []
    for camera in first.iterfind("camera"):
        given = {
            "c": camera.findtext("uncertainties/focalLengthPixel", ""),
            "x0": camera.findtext("uncertainties/principalPointXPixel", ""),
            "y0": camera.findtext("uncertainties/principalPointYPixel", ""),
        }
        sigmas.append({name: printed(text) for name, text in given.items() if printed(text) > 0})
    return QualityReport(
        "Pix4D", path, printed(None if atps is None else atps.get("meanProjectionError")), "mean",
        whole("images", "total"), whole("images", "calibrated"), rms("gcps"), rms("checkPoints"),
        checks=tuple(point.get("name", "") for point in (*points, *outer) if point.get("name")),
        camera_sigma_px=tuple(sigmas),
    )  # fmt: skip


def _xyz(element: Element) -> Triple:
    return printed(element.get("x")), printed(element.get("y")), printed(element.get("z"))


_MARKER = re.compile(rf"^(\S+) {_NUMBER} {_NUMBER} {_NUMBER} {_NUMBER} {_NUMBER} ?\((\d+)\)$")


def _of_metashape(path: Path, lines: list[str], text: str) -> QualityReport:
    """Captions stand below their tables, and say of whom they are."""
    rms: dict[str, Triple] = {}
    rows, values, factor, checks = list[str](), NOT_SAID, 0.01, list[str]()
    for before, line in zip(["", *lines], lines, strict=False):
        unit = re.search(r"X error \((\w+)\)", before)
        if unit:
            factor = _METRES.get(unit[1], 0.01)
            numbers = line.split(" ", 1)[-1] if before.startswith("Count") else line
            values = _three(numbers, factor)
        if marker := _MARKER.match(line):
            rows.append(marker[1])
        caption = re.match(
            r"Table \d+\. (Average camera location error|Control points|Check points)( RMSE)?", line
        )
        if caption:
            role = {"Average": "position", "Control": "control", "Check": "check"}[caption[1].split()[0]]
            if caption[2] or role == "position":
                rms[role] = values
            elif role == "check":
                checks = [name for name in rows if name != "Total"]
            rows = []
    images, stations = (_count(label, text) for label in ("Number of images", "Camera stations"))
    control, check, position = (rms.get(role, NOT_SAID) for role in ("control", "check", "position"))
    return QualityReport(
        "Metashape", path, _number_after("Reprojection error", text), "rms",
        images, stations, control, check, position, tuple(checks),
    )  # fmt: skip


def _of_odm(path: Path, lines: list[str], text: str) -> QualityReport:
    rms: dict[str, list[float]] = {}
    of = ""
    for line in lines:
        head = re.match(r"(GPS|GCP|3D|Checkpoints?|CP) Mean\b", line, re.IGNORECASE)
        if head:
            of = head[1].upper()
        elif of and re.match(r"[XYZ] Error \(meters\)", line):
            numbers = re.findall(_NUMBER, line.split(")", 1)[1])
            rms.setdefault(of, []).append(float(numbers[-1]) if numbers else math.nan)
    shown, images = _pair(r"(\d+) over (\d+) shots", text)
    error = re.search(rf"Average Reprojection Error .*?{_NUMBER} ?/ ?{_NUMBER} ?/", text)

    def three(*names: str) -> Triple:
        """Take what one of some heads has."""
        found = next((rms[name] for name in names if len(rms.get(name, ())) == 3), None)
        return NOT_SAID if found is None else (found[0], found[1], found[2])

    return QualityReport(
        "ODM", path, float(error[2]) if error else math.nan, "mean", images, shown, three("GCP"),
        three("CP", "CHECKPOINT", "CHECKPOINTS"), three("GPS"),
    )  # fmt: skip


def _of_statistics(path: Path) -> QualityReport | None:
    """ODM's and OpenSfM's stats.json."""
    content = read_json(path)
    if not isinstance(content, dict) or "reconstruction_statistics" not in content:
        return None

    def made() -> QualityReport:
        """Take what it says."""
        of: Mapping[str, Any] = content["reconstruction_statistics"]

        def rms(key: str) -> Triple:
            """Read the rms of a kind of observation."""
            error = content.get(key, {}).get("error", {})
            return printed(error.get("x")), printed(error.get("y")), printed(error.get("z"))

        return QualityReport(
            "ODM", path, printed(of.get("reprojection_error_pixels")), "mean",
            int(of.get("initial_shots_count", 0)), int(of.get("reconstructed_shots_count", 0)),
            rms("gcp_errors"), rms("checkpoint_errors"), rms("gps_errors"),
        )  # fmt: skip

    return structured(path, "a report of ODM", made)


def _of_colmap(path: Path, _: list[str], text: str) -> QualityReport:
    images, shown = (_count(label, text) for label in (r"(?<!Registered )Images", "Registered images"))
    mean = _number_after("Mean reprojection error", text)
    return QualityReport("COLMAP", path, mean, "mean", images, shown)


_RAY = re.compile(r"RES:\[(.+?)\]")
_GROUND = re.compile(rf"--NamePt (\S+) Ec Estim-Ter \[{_NUMBER},{_NUMBER},{_NUMBER}\]")


def _of_micmac(path: Path, lines: list[str], _: str) -> QualityReport:
    """What Tapas, GCPBascule and Campari print after each step: the last counts."""
    found = [_number_after(r"Residual =", line) for line in lines if "Residual =" in line]
    images = {match[1] for line in lines if (match := _RAY.search(line))}
    ground = {
        match[1]: [float(match[k]) for k in (2, 3, 4)] for line in lines if (match := _GROUND.search(line))
    }
    rms = NOT_SAID
    if ground:
        squares = [[value**2 for value in row] for row in ground.values()]
        x, y, z = (math.sqrt(sum(row[k] for row in squares) / len(squares)) for k in range(3))
        rms = (x, y, z)
    return QualityReport(
        "MicMac", path, found[-1] if found else math.nan, "rms", len(images), len(images), rms
    )


# By what the text of a report is recognised.
_PROGRAMS: dict[str, Callable[[Path, list[str], str], QualityReport]] = {
    r"ODM Quality Report|OpenSfM.*Report|OpenDroneMap": _of_odm,
    r"Pix4D|Mean Reprojection Error \[pixels\]": _of_pix4d,
    r"Agisoft|Metashape|PhotoScan": _of_metashape,
    r"Registered images:": _of_colmap,
    r"Residual = .*;;": _of_micmac,
}
