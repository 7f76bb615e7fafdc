"""Long study: flights that differ from the demonstration's, each from the wires to the certificate.

Writes `docs/evidence/variants.md`. Other cameras, heights, places, weather, bases, plans and points; image
observations instead of pictures. Each ends in a certificate whose values are those of the truth, or says what
the flight lacks.

Run: `make evidence`, or `python -m tests.evidence.variants [SEED ...]`.
"""

from __future__ import annotations

import datetime as dt
import os
import sys
import tempfile
import tomllib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from photocal.base.errors import PhotocalError
from photocal.demo.simulated import ComparedQuantity, against_truth
from photocal.run.campaign import run_one
from tests.simulated import FLIGHT, fly

SEEDS = (4,)
TIES = 200
DAY = dt.date(2025, 6, 16)
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "variants.md"
DEMO: dict[str, Any] = tomllib.loads(FLIGHT.read_text(encoding="utf-8"))
ONE, TWO = DEMO["plan"]["pass"]
Keys = dict[str, Any]


def changed(section: str, **keys: Any) -> Keys:
    """Change keys of a section of the demonstration's flight."""
    return {section: {**DEMO.get(section, {}), **keys}}


def flown(*passes: Keys, **keys: Any) -> Keys:
    """Fly other passes."""
    return changed("plan", **{"pass": list(passes)}, **keys)


def placed(latitude_deg: float, longitude_deg: float, height_m: float, crs: str) -> Keys:
    """Fly somewhere else."""
    return changed(
        "place", latitude_deg=latitude_deg, longitude_deg=longitude_deg, height_m=height_m, crs=crs
    )


TELE = {"size_px": [4000, 3000], "pitch_mm": 0.0045, "nominal_mm": 35.0, "fx": 7791.0, "fy": 7786.0}
TELE |= {"cx": 2012.0, "cy": 1489.0, "k1": -0.02, "k2": 0.05, "k3": 0.0, "p1": 1e-4, "p2": -1e-4}
STRIP = {**ONE, "course_deg": 90.0}
NARROW = [[-40.0, -8.0], [40.0, -8.0], [40.0, 8.0], [-40.0, 8.0]]
ODD_RIG = {"camera_to_antenna_m": [-0.12, 0.2, -0.4], "time_offset_s": 0.02}
LOSSES = {"vehicle_loss": 0.05, "vehicle_damage": 0.01, "rover_loss": 0.01, "rover_damage": 0.002}
VARIANTS: dict[str, Keys] = {
    "35 mm lens, 12 MP, at 120 and 160 m": {
        **changed("camera", **TELE),
        **flown({**ONE, "height_m": 120.0}, {**TWO, "height_m": 160.0}),
    },
    "5.5 mm lens": changed("camera", fx=760.0, fy=759.0, nominal_mm=5.5),
    "portrait format": changed("camera", size_px=[1216, 1824], cx=601.9, cy=918.2),
    "rolling shutter, 30 ms": changed("camera", readout_s=0.03),
    "at 90 and 120 m, 8 and 12 m/s": flown(
        {**ONE, "height_m": 90.0, "speed_m_s": 8.0}, {**TWO, "height_m": 120.0, "speed_m_s": 12.0}
    ),
    "one height": flown({**ONE}, {**TWO, "height_m": ONE["height_m"]}),
    "no cross strips": flown({**ONE}, {**TWO, "course_deg": ONE["course_deg"]}),
    "two strips": flown(STRIP, area_m=NARROW),
    "Berlin": placed(52.5, 13.4, 80.0, "EPSG:25833"),
    "Tromso": placed(69.6, 18.9, 60.0, "EPSG:25834"),
    "Christchurch": placed(-43.5, 172.6, 20.0, "EPSG:2193"),
    "Quito, 2850 m": placed(-0.18, -78.47, 2850.0, "EPSG:31997"),
    "across the date line": placed(-17.8, 179.9999, 30.0, "EPSG:32760"),
    "1500 m above the sea": changed("place", height_m=1500.0),
    "flat ground": changed("terrain", relief_m=0.0),
    "mountain": changed("terrain", relief_m=9.0, longest_m=200.0),
    "-20 deg C, dry": changed("air", temperature_c=-20.0, relative_humidity=0.2),
    "38 deg C, 90 % humidity": changed("air", temperature_c=38.0, relative_humidity=0.9),
    "wind and gusts": changed("vehicle", wind_m_s=8.0, sway_m=0.15, shake_deg=2.0),
    "base 3 km away": changed("gnss", base_m=[2100.0, -2140.0]),
    "base sends RTCM3": changed("gnss", base_protocol="rtcm3"),
    "rover at 1 Hz": changed("gnss", rover_interval_s=1.0),
    "losses on all links": changed("wires", **LOSSES),
    "autopilot's clock 80 ppm off": changed("telemetry", clock_drift_ppm=80.0),
    "antenna to the side, shutter 20 ms late and known": changed("rig", **ODD_RIG),
    "three control points": changed("targets", control=3, check=12),
    "no control points": changed("targets", control=0),
    "no check points": changed("targets", check=0),
    "orthometric heights, no geoid model": {},
}
# Edited in the project file, as somebody does who has no other heights.
ORTHOMETRIC = "orthometric heights, no geoid model"
Task = tuple[str, int]


@dataclass(frozen=True)
class Outcome:
    """How a flight ended.

    Attributes
    ----------
    figures : dict
        Of `photocal run`; empty when it refused.
    rows : tuple of Row
        Against the truth.
    refusal : str
    """

    figures: dict[str, Any]
    rows: tuple[ComparedQuantity, ...]
    refusal: str


def outcome(task: Task) -> Outcome:
    """Fly, process, compare with the truth."""
    name, seed = task
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "flight"
        project = fly(folder, seed=seed, observing={"ties": TIES}, **VARIANTS[name])
        if name == ORTHOMETRIC:
            text = project.read_text(encoding="utf-8")
            project.write_text(text.replace('"ellipsoidal"', '"orthometric"'), encoding="utf-8")
        try:
            figures = run_one(project, DAY, say=lambda _: None)
        except PhotocalError as refusal:
            return Outcome({}, (), str(refusal).replace(scratch, "."))
        return Outcome(figures, against_truth(folder / "truth", project.parent / "work"), "")


def row(name: str, seed: int, one: Outcome) -> str:
    """Line of the table."""
    if one.refusal:
        return f"| {name} | {seed} | | | | | | refused: {one.refusal} |"
    taken, fixed = one.figures["exposures"], one.figures["ppk"]["fixed_percent"]
    factor = one.figures["calibration"]["sigma0_squared"]
    worst = max(abs(value.deviation) / value.limit for value in one.rows)
    outside = ", ".join(f"{value.name} {value.deviation:+.1f}" for value in one.rows if not value.agrees)
    said = [w["code"] for w in one.figures["warnings"] if w["kind"] == "warning"]
    cells = [name, str(seed), f"{taken['matched']} of {taken['images']}", f"{fixed:.1f}", f"{factor:.2f}"]
    cells += [f"{worst:.2f}", outside or "-", ", ".join(dict.fromkeys(said)) or "-"]
    return "| " + " | ".join(cells) + " |"


def page(lines: list[str]) -> list[str]:
    """All that is written."""
    return [
        "# Flights of other kinds",
        "",
        "`acquire/simulate/flights/survey.toml` with the change in the first column, from raw GNSS and",
        f"telemetry to the certificate; observations instead of pictures, {TIES} tie points. Worst: the",
        "largest deviation of an estimate from the truth over its limit. The limit is 3 standard",
        "deviations for camera and mounting, 3 cm for antenna positions, and 3 standard deviations of the",
        "ratio of errors to prediction at the check points. Outside: estimates beyond the limit, in",
        "standard deviations. A flight has some twenty estimates; three in a thousand exceed the limit by",
        "chance.",
        "",
        "| flight | seed | images | fixed % | sigma0^2 | worst | outside | warnings |",
        "|---|---|---|---|---|---|---|---|",
        *lines,
    ]


def main(*seeds: int) -> None:
    """Fly all and write the table."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    tasks: list[Task] = [(name, seed) for name in VARIANTS for seed in seeds or SEEDS]
    lines = []
    with ProcessPoolExecutor(2) as pool:
        for task, one in zip(tasks, pool.map(outcome, tasks), strict=True):
            lines.append(row(*task, one))
            sys.stderr.write(lines[-1] + "\n")
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(page(lines)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
