"""Study: mutilated control lists and folders through `photocal new` and `photocal run --until control`.

A list as it should be suffers up to five accidents, its file some more, and the folder around it, too. Each
case must end with a project or a refusal in one line, and each row that was read must be used or named: by
`new` those of the list, by `run` those of the marks that `new` has written. Writes
`docs/evidence/mutilated-lists.md`.

Run: `make evidence`, or `python -m tests.evidence.mutilated_lists [COUNT [PROCESSES]]`.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
import typer

from photocal.base.console import run
from photocal.block.project import ASKED
from photocal.commands.cli import app, texts

OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "mutilated-lists.md"
COUNT = 2000
# Built once: that takes longer than most cases.
COMMANDS = typer.main.get_command(app)
PICTURES = tuple(f"a{k}.jpg" for k in range(4))
WIDTH, HEIGHT = 160, 120
SYSTEMS = (
    "EPSG:2180", "PUWG1992", "WGS84 UTM 22S", "EPSG:4326", "EPSG:999999", "local", "Poland", "",
    "Gauss-Boaga", "+proj=utm +zone=34 +datum=WGS84", "\x00\xff", "EPSG:2180+5773", "EPSG:4978", "UTM",
)  # fmt: skip
CELLS = ("nan", "inf", "1e400", "-1e300", "", "x", "1,5", "0", "99999999", "-3", "a0.jpg", "½", "P 1")
FOLDERS = (
    "intact", "a picture is gone", "a picture is cut", "a picture is empty",
    "EXIF rotates the pictures", "an unrelated table", "a second list",
    "a folder of the list's name", "no picture",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A folder that was written.

    rows: of its list; None where the file was cut, or begins with a row.
    """

    seed: int
    folder: str
    rows: int | None


@dataclass(frozen=True)
class Said:
    """What a command said; `broken` has the trace of what nobody caught."""

    code: int
    out: str
    err: str
    broken: str = ""


def answered(*arguments: str) -> Said:
    """Run a command in this process; warnings are errors, as in the tests."""
    out, err = io.StringIO(), io.StringIO()
    code, broken = 0, ""
    with (
        mock.patch.object(sys, "argv", ["photocal", *arguments]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("error")
        try:
            run(COMMANDS, texts, "photocal.commands")
        except SystemExit as end:
            code = int(end.code or 0)
        except BaseException:
            broken = traceback.format_exc()
    return Said(code, out.getvalue(), err.getvalue(), broken)


def pictures(folder: Path) -> None:
    """Four small pictures of one ground, each a step farther."""
    rng = np.random.default_rng(1)
    ground = cv2.GaussianBlur(rng.uniform(0, 255, (240, 320)).astype(np.float32), (0, 0), 3.0)
    ground = np.clip(128 + 9 * (ground - 128), 0, 255).astype(np.uint8)
    folder.mkdir(parents=True)
    for k, name in enumerate(PICTURES):
        cv2.imwrite(str(folder / name), ground[60 : 60 + HEIGHT, 25 * k : 25 * k + WIDTH])


def _rows(rng: np.random.Generator) -> list[list[str]]:
    """A list as it should be."""
    rows = []
    for k in range(int(rng.integers(1, 7))):
        east, north, height = rng.uniform([634500, 485200, 100], [634700, 485400, 120])
        x, y = rng.uniform([80, 0], [150, HEIGHT])
        for image in rng.choice(4, int(rng.integers(1, 5)), replace=False):
            cells = (f"{east:.3f}", f"{north:.3f}", f"{height:.3f}", f"{x - 25 * image:.1f}", f"{y:.1f}")
            rows.append([*cells, PICTURES[image], f"P{k}"])
    return rows


def _mutilated(rows: list[list[str]], rng: np.random.Generator) -> list[list[str]]:
    """The same after some accidents."""
    if rng.random() < 0.1:
        factor = float(rng.choice([0.5, 0.25, 2.0]))
        rows = [[*row[:3], *(f"{factor * float(cell):.1f}" for cell in row[3:5]), *row[5:]] for row in rows]
    for _ in range(int(rng.integers(0, 6))):
        k = int(rng.integers(len(rows)))
        row, cell = list(rows[k]), int(rng.integers(len(rows[k]) or 1))
        kind = int(rng.integers(10))
        if kind == 0 and row:
            row[cell % len(row)] = str(rng.choice(CELLS))
        elif kind == 1:
            row = row[:cell]
        elif kind == 2 and len(row) > 1:
            row[0], row[1] = row[1], row[0]
        elif kind == 3 and len(row) > 5:
            row[5] = str(rng.choice(["gone.jpg", "A0.JPG", "img/a1.jpg", "a2", "7"]))
        elif kind == 4 and len(row) > 6:
            row[6] = str(rng.choice(["P0", "P1", "", "point2"]))
        elif kind == 5:
            rows.insert(k, list(row))
        elif kind == 6 and len(row) > 4:
            row[3], row[4] = row[4], f"{float(rng.uniform(-500, 9000)):.0f}"
        elif kind == 7 and row:
            row[0] = row[0].replace(".", ",")
        elif kind == 8 and row:
            row[0] = row[0][1:] or "0"
        else:
            row = [*row, "more"]
        rows[k] = row
    return rows


def _list(path: Path, rng: np.random.Generator) -> int | None:
    """Write a list of one of many forms; give how many rows it has."""
    rows = [row for row in _mutilated(_rows(rng), rng) if "".join(row).strip()]
    between = str(rng.choice([" ", "\t", "  "]))
    lines = [between.join(row) for row in rows]
    lines = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    system = str(rng.choice(SYSTEMS))
    content = "\n".join([system, *lines]) + str(rng.choice(["\n", "", "\n\n# end\n"]))
    data = content.encode(str(rng.choice(["utf-8", "utf-8", "utf-8", "utf-16", "cp1252"])), "replace")
    if rng.random() < 0.1:
        data = data.replace(b"\n", b"\r\n")
    cut = rng.random() < 0.05
    path.write_bytes(data[: int(rng.integers(len(data)))] if cut else data)
    return None if cut or not system else len(lines)


def _folder(folder: Path, kind: str, rng: np.random.Generator) -> None:
    """What happens to the folder around the list."""
    one = folder / str(rng.choice(PICTURES))
    if kind == "a picture is gone":
        one.unlink()
    elif kind == "a picture is cut":
        one.write_bytes(one.read_bytes()[: int(rng.integers(1, 900))])
    elif kind == "a picture is empty":
        one.write_bytes(b"")
    elif kind == "EXIF rotates the pictures":
        from PIL import Image

        turned = Image.Exif()
        turned[0x0112] = int(rng.choice([3, 6, 8]))
        for name in PICTURES:
            Image.open(folder / name).save(folder / name, exif=turned)
    elif kind == "an unrelated table":
        (folder / "control.txt").write_bytes(rng.bytes(400) if rng.random() < 0.5 else b"a,b\n1,2\n")
    elif kind == "a second list":
        _list(folder / "gcp_list_2.txt", rng)
    elif kind == "a folder of the list's name":
        (folder / "marks.csv").mkdir()
    elif kind == "no picture":
        for name in PICTURES:
            (folder / name).unlink()


def write_case(folder: Path, made: Path, seed: int) -> Case:
    """Write the folder of a case.

    made: folder with the pictures.
    """
    rng = np.random.default_rng(seed)
    shutil.copytree(made, folder)
    kind = FOLDERS[int(rng.integers(1, len(FOLDERS)))] if rng.random() < 0.3 else FOLDERS[0]
    rows = _list(folder / "gcp_list.txt", rng)
    _folder(folder, kind, rng)
    return Case(seed, kind, rows)


def complaints(folder: Path, case: Case) -> tuple[list[str], str, str]:
    """Take a case through both commands: what is wrong, and how either ended."""
    more = ("--height", "ellipsoidal") if case.seed % 2 else ()
    said = answered("new", str(folder), "--json", *more)
    if said.broken:
        return [said.broken], "", ""
    if said.code:
        wrong = [] if _one_line(said) else [f"new said {said.err!r}"]
        if case.folder not in ("no picture", "a folder of the list's name"):
            wrong.append(f"new refuses: {said.err}")
        return wrong, f"refused: {_kind(said.err)}", ""
    found = json.loads(said.out)
    wrong = _lost_by_new(folder, case, found)
    ended = f"{'asks' if found['asked'] else 'settled'}, list {'read' if found['rows']['read'] else 'named'}"
    project = folder / "project.toml"
    text = project.read_text(encoding="utf-8")
    if (f'"{ASKED}"' in text) != bool(found["asked"]) and not any(a[:5] == "marks" for a in found["asked"]):
        wrong.append(f"asked {found['asked']} and project.toml do not agree")
    if f'"{ASKED}"' in text:
        text = re.sub(r'(?m)^(crs|height) = "[^"]*"', r'\1 = "local"', text)
    project.write_text(text, encoding="utf-8")
    said = answered("run", str(project), "--until", "control", "--json")
    if said.broken:
        return [*wrong, said.broken], ended, ""
    if said.code:
        wrong += [] if _one_line(said) else [f"run said {said.err!r}"]
        return wrong, ended, f"refused: {_kind(said.err)}"
    counted = json.loads(said.out)["control"]
    marks, written = counted["marks"], _written(folder)
    if not marks["read"] == written == marks["used"] + len(marks["not_used"]):
        wrong.append(f"run read {marks} of {written}")
    return wrong, ended, "passed" + (", some marks named" if marks["not_used"] else "")


def _lost_by_new(folder: Path, case: Case, found: dict[str, object]) -> list[str]:
    """Rows that are neither used nor named."""
    rows, wrong = found["rows"], []
    assert isinstance(rows, dict)
    if rows["read"] != rows["used"] + len(rows["not_used"]):
        wrong.append(f"{rows['read']} rows read, {rows['used']} used, {len(rows['not_used'])} named")
    if case.folder != "a second list":
        if case.rows is not None and rows["read"] not in (0, case.rows):
            wrong.append(f"{case.rows} rows stand there, {rows['read']} were read")
        if not rows["read"] and not any("gcp_list.txt" in line for line in _lines(found, "missing")):
            wrong.append("a list that cannot be read is not named")
    if rows["read"] and rows["used"] != _written(folder):
        wrong.append(f"{rows['used']} rows used, {_written(folder)} written")
    return wrong


def _lines(found: dict[str, object], key: str) -> list[str]:
    lines = found[key]
    assert isinstance(lines, list)
    return lines


def _written(folder: Path) -> int:
    """Marks that `new` has written."""
    path = folder / "marks.csv"
    return len(path.read_text(encoding="utf-8").splitlines()) - 1 if path.is_file() else 0


def _one_line(said: Said) -> bool:
    return said.err.startswith("error: ") and len(said.err.splitlines()) == 1


def _kind(line: str) -> str:
    """A refusal without names, places and numbers."""
    words = re.sub(r"^error: (?:\S*/\S+(?:, line \d+)?: )?", "", line.strip())
    return re.sub(r"'[^']*'|\"[^\"]*\"|[-+\d.,]*\d", "#", words).split(";")[0][:90]


def page(count: int, ended: Counter[tuple[str, str]], folders: Counter[str], broken: Sequence[str]) -> str:
    """Write the outcomes as a table."""
    lines = [
        "# Mutilated control lists",
        "",
        f"Made by `python -m tests.evidence.mutilated_lists`: {count} lists in fourteen coordinate systems",
        "and three encodings. Each has up to five defects in its rows: cells that are not numbers, cut and",
        "doubled rows, exchanged axes, other names of pictures and points, decimal commas, marks of",
        "another image size. Some lists are cut off. In three of ten cases the folder has a defect, too.",
        "",
        "Required: no uncaught exception, a refusal in one line, and no row that is neither used nor",
        f"named, by `new` and by `run --until control`. Seen: {len(broken)} cases that break this.",
        "",
        "| new | run --until control | cases |",
        "|---|---|---|",
        *(f"| {new} | {run} | {n} |" for (new, run), n in sorted(ended.items(), key=lambda row: -row[1])),
        "",
        "| folder | cases |",
        "|---|---|",
        *(f"| {name} | {folders[name]} |" for name in FOLDERS),
    ]  # fmt: skip
    return "\n".join([*lines, *(f"\n    {line}" for line in broken)]) + "\n"


def outcome(made: Path, scratch: Path, seed: int) -> tuple[Case, list[str], str, str]:
    """Write a case, take it through both commands, and leave nothing of it."""
    folder = scratch / str(seed)
    case = write_case(folder, made, seed)
    found = case, *complaints(folder, case)
    shutil.rmtree(folder)
    return found


def main(count: int, workers: int) -> None:
    """Run the study."""
    ended, folders, broken = Counter[tuple[str, str]](), Counter[str](), list[str]()
    with (
        tempfile.TemporaryDirectory() as scratch,
        ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as crew,
    ):
        made = Path(scratch, "made")
        pictures(made)
        each = crew.map(partial(outcome, made, Path(scratch)), range(count), chunksize=10)
        for case, wrong, new, run_ended in each:
            ended[new, run_ended] += 1
            folders[case.folder] += 1
            broken += [f"{case.seed} ({case.folder}): {line}" for line in wrong]
            for line in wrong:
                print(f"{case.seed} ({case.folder}): {line}", flush=True)
    written = page(count, ended, folders, broken)
    if count >= COUNT:
        OUTPUT.write_text(written, encoding="utf-8", newline="\n")
    print(written)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT, int(sys.argv[2]) if len(sys.argv) > 2 else 2)
