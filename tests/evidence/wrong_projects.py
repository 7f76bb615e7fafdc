"""Study: wrong projects made from the practice project; what ends the run must name the cause.

Writes `docs/evidence/wrong-projects.md`. One flight of the demonstration is simulated and processed as far as
its exposures; then one thing is made wrong at a time.

Run: `make evidence`, or `python -m tests.evidence.wrong_projects [SITE]`.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from typer.testing import CliRunner

from photocal.base.errors import PhotocalError
from photocal.commands.cli import app
from tests.simulated import PLANS, fly

OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "wrong-projects.md"
Rows = list[list[str]]


@dataclass(frozen=True)
class Wrong:
    """One mistake.

    Attributes
    ----------
    spoil : callable
        Changes the folder of the project.
    named : str
        What the refusal, or the first line of the verdict, must say (regular expression).
    """

    title: str
    spoil: Callable[[Path], None]
    named: str


def toml(old: str, new: str) -> Callable[[Path], None]:
    """Replace in the project file."""

    def spoil(site: Path) -> None:
        path = site / "project.toml"
        text = path.read_text(encoding="utf-8")
        assert re.search(old, text), old
        path.write_text(re.sub(old, new, text, count=1), encoding="utf-8")

    return spoil


def control(change: Callable[[list[str]], list[str]], separator: str = ",") -> Callable[[Path], None]:
    """Change every row of the control table."""

    def spoil(site: Path) -> None:
        path = site / "control.csv"
        head, *rows = (line.split(",") for line in path.read_text(encoding="utf-8").splitlines())
        path.write_text("\n".join(separator.join(row) for row in (head, *map(change, rows))) + "\n")

    return spoil


def scaled(factor: float, *columns: int) -> Callable[[list[str]], list[str]]:
    """Multiply columns of a row."""
    return lambda row: [f"{float(c) * factor:.4f}" if k in columns else c for k, c in enumerate(row)]


def moved(by: float, column: int) -> Callable[[list[str]], list[str]]:
    """Add to a column of a row."""
    return lambda row: [f"{float(c) + by:.4f}" if k == column else c for k, c in enumerate(row)]


def degrees(row: list[str]) -> list[str]:
    """Give a row geographic coordinates."""
    from pyproj import Transformer

    way = Transformer.from_crs("EPSG:31982", "EPSG:4326", always_xy=True)
    east, north = way.transform(float(row[1]), float(row[2]))
    return [row[0], f"{east:.9f}", f"{north:.9f}", *row[3:]]


CRS, BASE = r'crs = "EPSG:31982"', r"base_position = \[(\S+), (\S+), (\S+)\]"
CASES = (
    Wrong("geographic system, control in metres", toml(CRS, 'crs = "EPSG:4326"'), "degrees cannot be adj"),
    Wrong(
        "geographic system, control in degrees",
        lambda site: (toml(CRS, 'crs = "EPSG:4326"')(site), control(degrees)(site))[0],
        "degrees cannot be adjusted",
    ),
    Wrong("geocentric system", toml(CRS, 'crs = "EPSG:4978"'), "not a map system"),
    Wrong("unknown system", toml(CRS, 'crs = "EPSG:99999"'), "not a known coordinate system"),
    Wrong("system in feet", toml(CRS, 'crs = "EPSG:2225"'), "foot, not in metres"),
    Wrong("neighbouring zone", toml(CRS, 'crs = "EPSG:31983"'), "is not the zone .* that is EPSG:31982"),
    Wrong(
        "zone of the northern hemisphere",
        toml(CRS, 'crs = "EPSG:32622"'),
        "is not the zone .* that is EPSG:32722",
    ),
    Wrong("control in degrees, system in metres", control(degrees), "are in degrees"),
    Wrong("E and N exchanged", control(lambda r: [r[0], r[2], r[1], *r[3:]]), "E and N .* are exchanged"),
    Wrong("control in feet", control(scaled(1 / 0.3048, 1, 2, 3)), "the control points are in feet"),
    Wrong("control in millimetres", control(scaled(1000, 1, 2, 3)), "the control points are in millimetres"),
    Wrong("heights in feet", control(scaled(1 / 0.3048, 3)), "heights of the control points are in feet"),
    Wrong("heights all zero", control(scaled(0.0, 3)), "heights of all 4 control points are 0"),
    Wrong("all heights equal", control(lambda r: [*r[:3], "912.0000", *r[4:]]), "are 912"),
    Wrong("heights with a wrong sign", control(scaled(-1, 3)), "wrong sign"),
    Wrong("base: latitude and longitude exchanged", toml(BASE, r"base_position = [\2, \1, \3]"), "exchanged"),
    Wrong(
        "base: sign of the longitude",
        toml(BASE, r"base_position = [\1, 49.2313485214, \3]"),
        "sign of the longitude of base_position",
    ),
    Wrong(
        "base: sign of the latitude",
        toml(BASE, r"base_position = [25.4484624612, \2, \3]"),
        "sign of the latitude of base_position",
    ),
    Wrong("decimal commas between commas", control(lambda r: [c.replace(".", ",") for c in r]), "semicolons"),
    Wrong(
        "points and commas mixed",
        lambda site: (
            control(lambda r: r, ";")(site),
            (site / "control.csv").write_text((site / "control.csv").read_text().replace(".", ",", 1)),
        )[0],
        "one way",
    ),
    Wrong("other names in the table", control(lambda r: [r[0].lower(), *r[1:]]), "names the same"),
    Wrong("height kind without a system of heights", toml('"ellipsoidal"', '"orthometric"'), "EPSG:31982\\+"),
    Wrong(
        "heights of another kind",
        control(moved(-4.1, 3)),
        "antenna height .* ellipsoidal against geoid heights",
    ),
    Wrong("control shifted by 100 m", control(moved(100.0, 1)), "points lie .100 m east"),
)


def ending(site: Path, case: Wrong, folder: Path) -> tuple[str, bool]:
    """Run a wrong project: its refusal or the first line of its verdict, and whether a traceback was seen."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(site, folder, copy_function=shutil.copyfile)
    case.spoil(folder)
    said = CliRunner().invoke(app, ["run", str(folder / "project.toml")])
    if isinstance(said.exception, PhotocalError):
        return f"error: {said.exception}", False
    lines = (line.strip() for line in said.stdout.splitlines())
    return next((line[2:] for line in lines if line.startswith("* ")), ""), said.exception is not None


def main(site: Path | None) -> None:
    """Run all cases and write the page."""
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        if site is None:
            site = fly(place / "practice", PLANS / "small.toml").parent
        CliRunner().invoke(app, ["run", str(site / "project.toml"), "--until", "exposures"])
        rows = []
        for case in CASES:
            line, traceback = ending(site, case, place / "wrong")
            good = re.search(case.named, line) is not None and not traceback
            kept = (place / "wrong" / "work" / "ppk" / "stage.json").exists()
            shown = line.replace(str(place / "wrong") + "/", "").replace("|", "/")
            rows.append((case.title, good, kept, shown))
            sys.stderr.write(f"{'ok ' if good else 'BAD'} {case.title}: {shown[:160]}\n")
    named = sum(good for _, good, _, _ in rows)
    text = [
        "# Wrong projects",
        "",
        "Made by `python -m tests.evidence.wrong_projects`: the practice project with one error. The",
        "refusal of `photocal run`, or the first line of its verdict, names the cause in",
        f"**{named} of {len(rows)}**, without a traceback;",
        f"stages made before are kept in {sum(kept for *_, kept, _ in rows)}.",
        "",
        "| wrong | named | refusal, or first line of the verdict |",
        "|---|---|---|",
        *(f"| {title} | {'yes' if good else 'NO'} | {line[:200]} |" for title, good, _, line in rows),
    ]
    OUTPUT.write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
