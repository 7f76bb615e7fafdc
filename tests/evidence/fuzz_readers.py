"""Study: damaged files through every reader: tables, TOML, JSON, XML, MCAP, images, logs and archives.

Writes `docs/evidence/fuzz_readers.md`. Files that the program wrote, or that were recorded, are damaged as
bytes and as words (numbers that are none, endless nesting, lines lost or doubled) and read; what a reader may
do is to read them or to refuse them with an error of ours.

Run: `make evidence`, or `python -m tests.evidence.fuzz_readers [SECONDS a reader [PORTION [TALLY.json]]]`:
seconds are of processor time, so that a portion is as large on a busy machine; portions have seeds of their
own and are added up in the tally, from which the page is written.
"""

from __future__ import annotations

import datetime as dt
import gzip
import json
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from typer.testing import CliRunner

from acquire.channels.summary import summarise
from acquire.commands.cli import app as acquire_app
from acquire.importing.importer import identify, open_recording
from acquire.importing.recovery import recover
from acquire.recording.configuration import read_configuration
from acquire.simulate.world.configuration import read_configuration as read_flight
from drivers.mavlink.dialect import ardupilotmega
from photocal.base.errors import PhotocalError
from photocal.block.folder import read_block
from photocal.block.project import read_project
from photocal.block.results.adjusted_block import adjusted_block
from photocal.block.results.folder import read_result
from photocal.commands.cli import app
from photocal.exchange import bal
from photocal.exchange.colmap import read_colmap
from photocal.exchange.formats import FORMATS, read_foreign_block, read_foreign_project
from photocal.exchange.ground_points import read_gcp_list, read_geo
from photocal.exchange.metashape import read_metashape
from photocal.exchange.opensfm import read_reconstruction
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import read_grey
from photocal.measurement.position_files import read_positions
from photocal.navigation.engine import read_solution
from photocal.navigation.events import read_mrk
from photocal.navigation.precise_results import read_observation_file
from photocal.report.certificate_metadata import read_particulars
from tests.benchmarks import make_bal
from tests.photocal.exchange import test_rigs
from tests.photocal.exchange.test_hostile import small_archive
from tests.photocal.run.test_adopt import pix4d

SECONDS = 15.0
ROOT = Path(__file__).parents[2]
OUTPUT = ROOT / "docs" / "evidence" / "fuzz_readers.md"
LARGEST = 300_000
ASKED = 1_000_000
# Address space that a reader may take beyond that of the imported program, and resident memory of all.
MEMORY = 1_000_000_000
SENSOR_LINE = "#Focal Length mm assuming a sensor width of 23.04x17.28mm\n"
# Of each format so many files: images have one each in some.
MOST_FILES = 4
# Of each reader so many files that fell are kept, to be looked at.
MOST_KEPT = 3
REPAIRED = (
    "Found by earlier portions and repaired:",
    "",
    "- OpenCV's own reader of calibrations wrote beyond its memory and ended the program",
    "  (such files are now read without it);",
    "- an archive whose compression asks for a dictionary of a gigabyte;",
    "- a Pix4D project with a word or a truncated row in a matrix;",
    "- rigs with vectors of the wrong length, with a list as their prefix, or without a rotation;",
    "- rig assignments that are a number;",
    "- a PhotoModeler export that ends after its photos;",
    "- a RINEX file whose antenna or epochs are not numbers;",
    "- archives with names that are not text;",
    "- a sensor width with two decimal points;",
    "- a name of 300 letters.",
)
LENGTHS = (0, 1 << 31, (1 << 32) - 1, 1 << 20)
WORDS = (
    b"nan", b"-1", b"0", b"1e999", b"99999999999999999999", b"\xff\xfe", b"\0", b"[" * 3000, b"<a>" * 500,
    b'"', b"\r",
    b"../../x", b"\xef\xbb\xbf", b"true", b"", b"=", b"{}", b"1e-320", b",,,,", b";",
)  # fmt: skip


@dataclass(frozen=True)
class Reader:
    """A reader: its kind, the file that is damaged, and what reads it from where it lies."""

    kind: str
    file: Path
    read: Callable[[Path], object]


def harmed(data: bytes, chance: np.random.Generator) -> bytes:
    """Return a file with one to four harms, of bytes or of words."""
    octets = bytearray(data)
    for _ in range(int(chance.integers(1, 5))):
        at, kind = int(chance.integers(0, len(octets) + 1)), int(chance.integers(0, 8))
        end = at + int(chance.integers(1, 60))
        if kind == 0 and at < len(octets):
            octets[at] ^= 1 << int(chance.integers(0, 8))
        elif kind == 1:
            del octets[at:end]
        elif kind == 2:
            octets[at:at] = octets[at:end]
        elif kind == 3:
            octets[at : at + int(chance.integers(0, 9))] = WORDS[int(chance.integers(0, len(WORDS)))]
        elif kind == 4:
            octets[at : at + 4] = int(chance.choice(LENGTHS)).to_bytes(4, "little")
        elif kind == 5:
            del octets[at : (octets.find(b"\n", at) + 1) or None]
        elif kind == 6:
            octets[at:at] = chance.bytes(int(chance.integers(1, 20)))
        elif chance.integers(0, 4) == 0:
            del octets[at:]
    return bytes(octets)


def _call(program: object, *words: object) -> None:
    done = CliRunner().invoke(program, [str(word) for word in words], catch_exceptions=False)  # type: ignore[arg-type]
    assert done.exit_code == 0, done.output


def readers(folder: Path) -> Iterator[Reader]:
    """Write the files that are damaged, and say what reads each."""
    block = folder / "block"
    shutil.copytree(ROOT / "photocal" / "demo" / "dcs460", block)
    run = folder / "run"
    _call(app, "adjust", block, "-o", run)
    for path in sorted(block.glob("*.*")):
        if path.suffix in (".toml", ".csv"):
            yield Reader("TOML" if path.suffix == ".toml" else "tables", path, lambda p: read_block(p.parent))
    for name in ("result.json", "images.csv", "points.csv", "residuals.csv"):
        if (run / name).is_file():
            yield Reader(
                "JSON" if name.endswith("json") else "tables", run / name, lambda p: read_result(p.parent)
            )
    yield from _exported(run, folder)
    yield from _foreign(run, folder)
    picture = np.random.default_rng(1).integers(0, 255, (96, 128, 3), np.uint8)
    for suffix in (".jpg", ".png", ".tif"):
        path = folder / f"picture{suffix}"
        cv2.imwrite(str(path), picture)
        for read in (read_grey, read_facts):
            yield Reader("images", path, read)
    yield from _flight(folder)


def _exported(run: Path, folder: Path) -> Iterator[Reader]:
    """Give a run in the formats of other programs."""
    kinds = {
        ".xml": "XML",
        ".kml": "XML",
        ".json": "JSON",
        ".opf": "JSON",
        ".geojson": "JSON",
        ".bin": "binary",
    }
    for form in FORMATS:
        if not form.writes:
            continue
        out = folder / f"as-{form.name}"
        if CliRunner().invoke(app, ["export", str(run), "--format", form.name, "-o", str(out)]).exit_code:
            continue
        if form.name == "jaicov":
            # Nothing else states the precision of the image coordinates.
            (out / "block.htm").write_text("<p>S0 apriori: 0.5</p>")
        files = sorted(p for p in out.rglob("*") if p.is_file() and p.stat().st_size < LARGEST)
        for path in files[:MOST_FILES]:
            kind = kinds.get(path.suffix, "tables")
            if form.reads:
                yield Reader(kind, path, _of_folder(form.read, out))
            # Cameras alone are no reconstruction.
            if form.reads and form.detect(path) and path.name != "cameras.json":
                yield Reader(kind, path, form.read)
            if form.name == "odm":
                yield Reader(kind, path, read_gcp_list if path.name == "gcp_list.txt" else read_geo)


def _foreign(run: Path, folder: Path) -> Iterator[Reader]:
    """Projects that are read and not written: of Pix4D and PhotoScan, and the rigs of other programs."""
    params, *rigs = (
        folder / name for name in ("params", "opensfm-rig", "colmap-rig", "colmap-config", "psx")
    )
    for own in (params, *rigs):
        own.mkdir()
    pix4d(params, adjusted_block(read_result(run))[0])
    (params / "field 3_camera.cam").write_text(SENSOR_LINE)
    archive = small_archive(folder, {})
    for name in ("problem.txt", "problem.txt.bz2", "problem.txt.gz"):
        make_bal.write(make_bal.make(make_bal.Shape(5, 40, 110, "street")), folder / name)
        yield Reader("tables" if name.endswith("txt") else "archives", folder / name, bal.read)
    test_rigs.test_opensfm(rigs[0])
    test_rigs.test_colmap(rigs[1], "model")
    test_rigs.test_colmap(rigs[2], "config")
    test_rigs.test_metashape(rigs[3])
    yield Reader("archives", archive, read_foreign_block)
    for kind, own, read in (
        ("tables", params, read_foreign_project),
        ("JSON", rigs[0], lambda p: read_reconstruction(p / "reconstruction.json")),
        ("tables", rigs[1], read_colmap),
        ("JSON", rigs[2], read_colmap),
        ("XML", rigs[3], lambda p: read_metashape(next(p.glob("*.xml")))),
    ):
        for path in sorted(own.iterdir()):
            if not path.name.startswith(("points3D", "images")):
                yield Reader(kind, path, _of_folder(read, own))


def _of_folder(read: Callable[[Path], object], folder: Path) -> Callable[[Path], object]:
    return lambda _: read(folder)


def _flight(folder: Path) -> Iterator[Reader]:
    """Files of a simulated flight: project, configuration, logs, archives."""
    practice = folder / "practice"
    _call(acquire_app, "simulate", "flight", "small", "--level", "observations", "-o", practice)
    yield Reader("TOML", practice / "site" / "project.toml", read_project)
    of_person = practice / "site" / "particulars.toml"
    yield Reader("TOML", of_person, lambda p: read_particulars(p, dt.date(2026, 5, 18)))
    yield Reader("TOML", practice / "truth" / "flight.toml", read_flight)
    settings = folder / "record.toml"
    settings.write_text(
        '[recording]\noutput = "logs"\n[[link]]\nname = "v"\nprotocol = "mavlink"\nurl = "udp://:1"\n'
    )
    yield Reader("TOML", settings, read_configuration)
    for path in sorted((practice / "site").glob("*.*")):
        data = path.read_bytes()[:60_000]
        if path.suffix not in (".ubx", ".tlog", ".rtcm3"):
            continue
        short = folder / f"short{path.suffix}"
        short.write_bytes(data)
        yield Reader("logs", short, lambda p: _imported(p))
        packed = folder / f"packed{path.suffix}.gz"
        packed.write_bytes(gzip.compress(data))
        yield Reader("archives", packed, lambda p: _imported(p))
        log = folder / f"log-{path.name}.mcap"
        _call(acquire_app, "import", short, "-o", log)
        yield Reader("MCAP", log, summarise)
        yield Reader("MCAP", log, lambda p: recover(p, p.with_name("fixed.mcap")))
    mrk = folder / "x_Timestamp.MRK"
    place = "47.6436873208,Lat\t16.4759271684,Lon\t512.998,Ellh\t0.014391, 0.013698, 0.029694\t50,Q\n"
    mrk.write_text("".join(f"{n}\t29628{n}.24\t[2211]\t 3,N\t 0,E\t 75,V\t{place}" for n in range(1, 9)))
    yield Reader("logs", mrk, read_mrk)
    events = folder / "x_events.pos"
    row = (
        "2026/05/18 10:18:0{}.234  47.643687320  16.475927168  512.9980  1 11  0.0130  0.0140  0.0290 0 0 0\n"
    )
    events.write_text("".join(map(row.format, range(1, 9))))
    yield Reader(
        "tables", events, lambda p: read_positions(p, [ImageFacts(f"a{k}.jpg", (64, 48)) for k in range(8)])
    )
    # Two lines more than pictures, which know their times: the events are matched.
    moments = np.cumsum([0.0, 2.1, 3.0, 2.4, 1.9, 2.7, 3.3, 2.2, 2.6, 3.1])
    taken = [f"2026-05-18T10:{int(s) // 60:02d}:{s % 60:06.3f}" for s in moments]
    pictures = [
        ImageFacts(f"a{k}.jpg", (64, 48), taken=moment, latitude_deg=47.64 + k * 1e-5, longitude_deg=16.47)
        for k, moment in enumerate(taken[1:-1])
    ]
    table = folder / "events.csv"
    rows = [
        f"{moment},{47.64 + k * 1e-5:.7f},16.47,512.9,0.02,0.02,0.04" for k, moment in enumerate(taken, -1)
    ]
    table.write_text("\n".join(["time,latitude,longitude,height,sE,sN,sh", *rows]) + "\n")
    yield Reader("tables", table, lambda p: read_positions(p, pictures))
    rinex = ROOT.parent / "shared" / "data" / "gnss-rinex-static-known" / "rover.obs"
    if rinex.is_file():
        short = folder / "short.obs"
        short.write_bytes(rinex.read_bytes()[:40_000])
        yield Reader("tables", short, read_observation_file)
        solution = folder / "short.pos"
        row = "2316 115200.000 35.1 136.9 104.8 1 9 0.01 0.01 0.02 0 0 0 0.0 50.0 0.1 0.1 0.1\n"
        solution.write_text(row * 50)
        yield Reader("tables", solution, read_solution)


def _imported(path: Path) -> None:
    dialect = ardupilotmega()
    with open_recording(path) as source:
        framer = identify(source, dialect).framer(dialect)
        for piece in source.pieces():
            framer.feed(piece)
        framer.close()


def _limit_memory() -> None:
    """Refuse memory beyond a gigabyte more than the program with its libraries has mapped."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _attack(reader: Reader, chance: np.random.Generator, seconds: float) -> dict[str, object]:
    """Damage one reader's file again and again for some seconds, and count what came of it."""
    whole, fallen = reader.file.read_bytes(), Counter[str]()
    cases = refused = 0
    slowest, until = 0.0, time.process_time() + seconds
    while time.process_time() < until:
        reader.file.write_bytes(harmed(whole, chance))
        begun = time.process_time()
        cases += 1
        try:
            reader.read(reader.file)
        except PhotocalError:
            refused += 1
        except Exception as failure:
            frames = traceback.extract_tb(failure.__traceback__)
            place = [f for f in frames if "photocal" in f.filename or "acquire" in f.filename][-1]
            where = f"{Path(place.filename).name}:{place.lineno}"
            fallen[f"{reader.file.name}: {type(failure).__name__} {str(failure)[:60]!r} {where}"] += 1
            if fallen.total() <= MOST_KEPT:
                kept = Path(tempfile.gettempdir()) / f"fallen-{where}-{fallen.total()}{reader.file.suffix}"
                shutil.copyfile(reader.file, kept)
        slowest = max(slowest, time.process_time() - begun)
    reader.file.write_bytes(whole)
    return {
        "kind": reader.kind,
        "cases": cases,
        "refused": refused,
        "slowest": slowest,
        "fallen": dict(fallen),
    }


def main() -> None:
    """Run one portion of the study, add it to the tally and write the table."""
    warnings.simplefilter("ignore")
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    portion = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    with tempfile.TemporaryDirectory() as scratch:
        tally_file = Path(sys.argv[3]) if len(sys.argv) > 3 else Path(scratch) / "tally.json"
        tally = json.loads(tally_file.read_text()) if tally_file.is_file() else []
        attacked = list(readers(Path(scratch)))
        _limit_memory()
        for number, reader in enumerate(attacked):
            chance = np.random.default_rng([portion, number])
            tally.append({"reader": number} | _attack(reader, chance, seconds))
            sys.stderr.write(f"{reader.file.name} {tally[-1]}\n")
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
            tally[-1]["memory_mb"] = memory
            tally_file.write_text(json.dumps(tally))
    write_page(tally)


def write_page(tally: list[dict[str, Any]]) -> None:
    """Write the page from all portions."""
    fallen = Counter[str]()
    rows = []
    for kind in sorted({run["kind"] for run in tally}):
        of_kind = [run for run in tally if run["kind"] == kind]
        cases, refused = (sum(run[name] for run in of_kind) for name in ("cases", "refused"))
        readers, slowest = len({run["reader"] for run in of_kind}), max(run["slowest"] for run in of_kind)
        rows.append(f"| {kind} | {readers} | {cases:,} | {refused:,} | {slowest:.2f} s |")
        for run in of_kind:
            fallen.update(run["fallen"])
    total = sum(run["cases"] for run in tally)
    lines = [
        "# Damaged files through every reader",
        "",
        f"{total:,} damaged files; {ASKED:,} are required, further portions add to them. Damage: bits",
        "flipped; bytes removed, inserted or doubled; lengths changed; words in place of numbers; endless",
        "nesting; lines lost. Each file is read, or refused with a message. Uncaught errors:",
        f"{fallen.total()}. A reader may map {MEMORY / 1e9:.0f} GB more than the program with its",
        "libraries; a larger request would be listed here as an uncaught error. Peak memory of the whole",
        f"process: {max(run['memory_mb'] for run in tally):.0f} MB.",
        "",
        "| files | readers | cases | refused | slowest |",
        "|---|---|---|---|---|",
        *rows,
        "",
        *(f"- {count} times {what}" for what, count in fallen.most_common()),
        *([""] if fallen else []),
        *REPAIRED,
        "",
        "Made by `python -m tests.evidence.fuzz_readers`, in portions with seeds of their own.",
        "",
    ]
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")
    sys.stderr.write("\n".join(lines))


if __name__ == "__main__":
    main()
