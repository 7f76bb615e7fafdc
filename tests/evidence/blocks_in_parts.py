"""Study of blocks in parts: the results of the whole, time, memory, and what a million images would take.

Simulated strips, each point seen by five to eight images, some 200 rays of an image, one camera. Up to 2 000
images the same block is adjusted whole, too. Larger ones are made and divided strip by strip and adjusted by
two processes. Writes `docs/evidence/large-blocks.md`.

Run: `python -m tests.evidence.blocks_in_parts [--rows FILE] [SIZE ...]`; sizes 2000, 10000 and 50000 where
none is given. What was measured before and stands in the file is not measured again.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from photocal.adjustment.adjust import adjust
from photocal.adjustment.parts.adjusting import adjust_parts, solution_of_parts
from photocal.adjustment.parts.dissection import dissect
from photocal.adjustment.parts.forecast import Forecast, forecast
from photocal.adjustment.parts.portions import Portion, together_in, write_parts, write_portions
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import Iteration
from tests.photocal.strips import Floats, Strips

OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "large-blocks.md"
# Strips and images of each; inner images of a part.
SHAPES = {2000: (40, 50, 300), 10_000: (100, 100, 300), 50_000: (200, 250, 400)}
MILLION = (800, 1250, 600)
WORKERS, RAYS, SHARED = 2, 200, 7
GIB = 2.0**30
COMPARED = {
    "positions of the images": Strips(40, 50, rays=RAYS),
    "antenna, lever arm unknown; three cameras; control": Strips(
        40, 50, rays=RAYS, antenna=True, cameras=3, control=500
    ),
    "control alone": Strips(40, 50, rays=RAYS, positions=False, control=50),
    "free, inner constraints": Strips(40, 50, rays=RAYS, positions=False),
}


def portions(flight: Strips) -> Iterator[Portion]:
    """The block strip by strip."""
    poses, first, first_ray = flight.poses(), 0, 0
    for strip in range(flight.strips):
        points, rays = flight.points_and_rays(strip, poses)
        numbers = first + np.arange(len(points.values))
        of_rays = first_ray + np.arange(len(rays.image))
        yield Portion(points, rays, tuple(f"p{j}" for j in numbers), numbers, of_rays)
        first, first_ray = first + len(numbers), first_ray + len(of_rays)


def measured(size: int) -> dict[str, Any]:
    """Make, divide and adjust a block; processor seconds, memory and sizes."""
    strips, each, most = SHAPES[size]
    flight = Strips(strips, each, rays=RAYS)
    frame = flight.frame()
    centre = frame.exposures.started[:, 3:]
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        together = together_in(portions(flight), size)
        dissection = dissect(together, centre, most)
        sizes = forecast(together, centre, dissection, SHARED)
        write_portions(frame, portions(flight), dissection, Path(folder))
        divide = time.process_time() - began
        began, clock, steps = time.process_time(), time.monotonic(), list[Iteration]()

        def report(step: Iteration) -> None:
            steps.append(step)
            print(size, step, f"{time.monotonic() - clock:.0f} s", file=sys.stderr, flush=True)

        adjusted = adjust_parts(Path(folder), dissection, WORKERS, report)
        clock, master = time.monotonic() - clock, time.process_time() - began
    own, workers = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    # Where the last step is negligible its equations serve the covariances.
    kept = steps[-1].decrement < 1e-12
    return {
        "images": size,
        "rays": sum(group.observations for group in adjusted.groups if group.name == "image") // 2,
        "unknowns": adjusted.unknowns,
        "parts": len(dissection.parts),
        "factorisations": len(steps) + (0 if kept else 1),
        "divide_s": divide,
        "master_s": master,
        "workers_s": workers.ru_utime + workers.ru_stime,
        "clock_s": clock,
        "master_gib": own.ru_maxrss * 1024 / GIB,
        "worker_gib": workers.ru_maxrss * 1024 / GIB,
        "variance_factor": adjusted.chi_squared / (adjusted.observations - adjusted.unknowns),
        "c": float(adjusted.cameras[0, 0]),
        "sigma_c": float(np.sqrt(adjusted.camera_covariance[0, 0, 0])),
        "sizes": listed(sizes),
    }


def compared(flight: Strips) -> dict[str, float]:
    """Adjust a block whole and in parts; largest differences."""
    network = flight.network()
    began = time.process_time()
    whole = adjust(network)
    of_whole = time.process_time() - began
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        dissection = write_parts(network, 300, Path(folder))
        adjusted = adjust_parts(Path(folder), dissection, free=network.datum_points is not None)
        found = solution_of_parts(Path(folder), adjusted, len(dissection.parts))
    return {
        "parts": len(dissection.parts),
        "whole_s": of_whole,
        "parts_s": time.process_time() - began,
        "chi": abs(found.chi_squared / whole.chi_squared - 1),
        **differences(found, whole),
        "redundancy": float(np.abs(found.redundancy - whole.redundancy).max()),
    }


def differences(found: Solution, whole: Solution) -> dict[str, float]:
    """Largest differences of values, in their standard deviations, and of these, as a share."""
    result, ratio = dict[str, float](), 0.0
    kinds = ("cameras", "camera"), ("exposures", "exposure"), ("points", "point")
    for values, of in kinds:
        one, other = (sigmas(getattr(each, f"{of}_covariance")) for each in (found, whole))
        known = other > 0
        off = getattr(found, values) - getattr(whole, values)
        if of == "exposure":
            off[:, :3] = np.remainder(off[:, :3] + np.pi, 2 * np.pi) - np.pi
        result[values] = float(np.abs(off[known] / other[known]).max())
        ratio = max(ratio, float(np.abs(one[known] / other[known] - 1).max()))
    return {**result, "ratio": ratio}


def sigmas(covariance: Floats) -> Floats:
    """Standard deviations of covariance matrices."""
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))


def sizes_of(row: Mapping[str, Any]) -> Forecast:
    """What was counted of a block before it was adjusted."""
    stored = row["sizes"]
    arrays = {name: np.array(stored[name]) for name in ("inner", "reach", "border", "own", "above")}
    return Forecast(**arrays, waiting=int(stored["waiting"]), shared=int(stored["shared"]))


def million() -> Forecast:
    """Count a block of a million images: those one strip and three images apart at most share points."""
    strips, each, most = MILLION
    strip, place = np.divmod(np.arange(strips * each), each)
    rows, columns = [], []
    for across in (-1, 0, 1):
        for along in range(-3, 4):
            there = (strip + across >= 0) & (strip + across < strips)
            there &= (place + along >= 0) & (place + along < each)
            image = np.flatnonzero(there)
            rows.append(image.astype(np.int32))
            columns.append((image + across * each + along).astype(np.int32))
    ends = np.concatenate(rows), np.concatenate(columns)
    together = csr_array((np.ones(len(ends[0]), dtype=np.int8), ends), shape=(strips * each,) * 2)
    centre = np.column_stack([strip, place, 0 * strip]) * [*Strips(1, 1).steps, 0.0]
    return forecast(together, centre, dissect(together, centre, most), SHARED)


def model(rows: Mapping[str, Mapping[str, Any]]) -> tuple[float, float, float, float]:
    """Calibrate seconds from the two smaller blocks.

    returns: of a worker process to start, of an image in a worker for each set-up of the equations, of the
    master for 1e9 operations, and for 1e9 bytes of fronts that it takes.
    """
    small, large = rows["2000"], rows["10000"]
    work = [[WORKERS, row["images"] * (row["factorisations"] + 1.0)] for row in (small, large)]
    start, image = np.linalg.solve(work, [small["workers_s"], large["workers_s"]])
    joined = [list(upper(sizes_of(row), row["factorisations"])) for row in (small, large)]
    operation, byte = np.linalg.solve(joined, [small["master_s"], large["master_s"]])
    return float(start), float(image), float(operation), float(byte)


def upper(sizes: Forecast, times: int) -> tuple[float, float]:
    """Operations (1e9) and bytes (1e9) of all that joins the parts, factorised so often and inverted once."""
    flops = times * sizes.upper_factor_flops + sizes.upper_inverse_flops
    return flops / 1e9, (times + 1) * sizes.traffic_bytes / 1e9


def row_of(name: str) -> dict[str, Any]:
    """Make one row: of a size, of a comparison, or of a million images."""
    if name == "million":
        return {"sizes": listed(million())}
    return measured(int(name)) if name.isdecimal() else compared(COMPARED[name])


def listed(sizes: Forecast) -> dict[str, Any]:
    """Sizes as JSON has them."""
    return {name: np.asarray(value).tolist() for name, value in asdict(sizes).items()}


def main() -> None:
    """Measure what the command line asks for, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sizes", type=int, nargs="*")
    parser.add_argument("--rows", type=Path, default=Path(tempfile.gettempdir()) / "blocks-in-parts.json")
    parser.add_argument("--only", default="", help="measure one row and print it")
    given = parser.parse_args()
    if given.only:
        print(json.dumps(row_of(given.only)))
        return
    rows = json.loads(given.rows.read_text()) if given.rows.exists() else {}
    asked = [str(size) for size in given.sizes or SHAPES] + ([] if given.sizes else [*COMPARED, "million"])
    threads = {"OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    for name in asked:
        if name not in rows:
            # A process of its own for each: peaks of memory do not fall again.
            command = [sys.executable, "-m", "tests.evidence.blocks_in_parts", "--only", name]
            done = subprocess.run(
                command, env={**os.environ, **threads}, check=True, stdout=subprocess.PIPE, text=True
            )
            rows[name] = json.loads(done.stdout)
            given.rows.write_text(json.dumps(rows))
    if {*map(str, SHAPES), *COMPARED, "million"} <= set(rows):
        OUTPUT.write_text(page(rows), encoding="utf-8")


def table(head: str, lines: Iterable[Sequence[object]]) -> list[str]:
    """A table of a page, its head written with strokes."""
    ruled = f"|{'---|' * (1 + head.count(' | '))}"
    return [f"| {head} |", ruled, *(f"| {' | '.join(map(str, line))} |" for line in lines), ""]


def page(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """The page of the study."""
    start, image, operation, byte = model(rows)
    large = rows["50000"]
    sizes = sizes_of(large)
    flops, traffic = upper(sizes, large["factorisations"])
    of_parts = WORKERS * start + image * large["images"] * (large["factorisations"] + 1)
    figures = {
        "rays": RAYS,
        "workers": WORKERS,
        "start": f"{start:.1f}",
        "image": f"{1e3 * image:.2f}",
        "operation": f"{operation:.3f}",
        "byte": f"{byte:.1f}",
    }
    predicted = [
        ("parts, s", f"{of_parts:.0f}", f"{large['workers_s']:.0f}"),
        ("joined, s", f"{operation * flops + byte * traffic:.0f}", f"{large['master_s']:.0f}"),
        (
            "memory of the joining process, GiB",
            f"{sizes.upper_bytes / GIB:.1f} and its program",
            f"{large['master_gib']:.1f}",
        ),
    ]
    lines = [
        *HEAD.format(**figures).splitlines(),
        "",
        *table(
            "block | parts | cameras | exposures | points | standard deviations | v'Pv | redundancies | "
            "whole, s | in parts, s",
            (of_comparison(name, rows[name]) for name in COMPARED),
        ),
        *TIME.format(**figures).splitlines(),
        "",
        *table(
            "images | rays | unknowns | parts | set-ups | divided, s | joined, s | parts, s | clock, s | "
            "peak, GiB: joining, each of the parts' | c, mm (true: 20)",
            (of_size(rows[str(size)]) for size in SHAPES),
        ),
        *COST.format(**figures).splitlines(),
        "",
        *table(" | predicted | measured", predicted),
        *of_million(sizes_of(rows["million"]), int(large["factorisations"]), image, operation, byte),
    ]
    return "\n".join(lines) + "\n"


HEAD = """# Large blocks

Made by `python -m tests.evidence.blocks_in_parts`: simulated strips, each point seen by five to eight
images, about {rays} rays of an image. A block in parts (`photocal adjust --parts`) is eliminated part by
part and joined along separators: Helmert's method, exact, with the covariances of everything.

## The same results

2 000 images adjusted whole and in parts, in one process. Largest difference of any value, in its standard
deviation; of any standard deviation, and of v'Pv, as a share; of any redundancy number. Asked: 0.01
standard deviations. Processor seconds, one thread.
"""

TIME = """## Time and memory

Made and divided strip by strip, adjusted by {workers} processes beside the one that joins them, each with
one thread, on two cores. Processor seconds; the cores had other work, which lengthens the time by the
clock. All end with the covariance of every camera, exposure and point and the redundancy number of every
ray. Of the parts, no process holds more than its own; the joining process never holds rays.
"""

COST = """## What it costs

Calibrated on 2 000 and 10 000 images: {start} s of each process to start, {image} ms of an image for each
set-up of the equations (the covariances count as one); for what joins the parts {operation} s for 1e9
operations and {byte} s for 1e9 bytes that are handed on. Operations and bytes are counted from which
images share points (`photocal/adjustment/parts/forecast.py`). For 50 000 images this gives
"""

MILLION_TEXT = """## A million images

Not computed: {strips} strips of {each} images, {rays:.0f} million rays, {times} set-ups as for 50 000. All
sizes are counted from which images share points.
"""

LIMITS = """Joining is done by one core, which limits it. The branches of the tree do not depend on each other
and could be joined by the processes of the parts; that is not built. The time of an image in the parts is
that of parts of some 200 images; those of larger parts have larger borders.
"""


def of_comparison(name: str, row: Mapping[str, Any]) -> list[object]:
    """A line of the first table."""
    keys = ("cameras", "exposures", "points", "ratio", "chi", "redundancy")
    differences = [f"{row[key]:.0e}" for key in keys]
    return [name, row["parts"], *differences, f"{row['whole_s']:.1f}", f"{row['parts_s']:.1f}"]


def of_size(row: Mapping[str, Any]) -> list[object]:
    """A line of the second table."""
    counts = [row[key] for key in ("images", "rays", "unknowns", "parts", "factorisations")]
    seconds = [f"{row[key]:.0f}" for key in ("divide_s", "master_s", "workers_s", "clock_s")]
    memory = f"{row['master_gib']:.1f}, {row['worker_gib']:.1f}"
    return [*counts, *seconds, memory, f"{row['c']:.4f} ± {row['sigma_c']:.4f}"]


def of_million(sizes: Forecast, times: int, image: float, operation: float, byte: float) -> list[str]:
    """What a million images would take."""
    flops, traffic = upper(sizes, times)
    count = int(sizes.inner.sum() + sizes.own.sum())
    of_parts, of_upper = image * count * (times + 1) / 3600, (operation * flops + byte * traffic) / 3600
    # Of each ray, with its share of a point, arrays of some 450 bytes, as measured with 50 000 images.
    held = sizes.part_bytes.sum() + 450.0 * RAYS * count
    counted = [
        ("parts", len(sizes.inner)),
        (
            "inner images of a part; in common with others",
            f"{sizes.inner.mean():.0f}; {sizes.border.mean():.0f}",
        ),
        ("images in separators; in the last one", f"{int(sizes.own.sum())}; {int(sizes.own[-1])}"),
        ("unknowns of the largest front", 6 * int((sizes.own + sizes.above).max()) + sizes.shared),
        ("operations that join, each set-up", f"{sizes.upper_factor_flops / 1e12:.1f}e12"),
        ("operations of the covariances above", f"{sizes.upper_inverse_flops / 1e12:.1f}e12"),
        ("handed on, each set-up", f"{sizes.traffic_bytes / 1e9:.0f} GB"),
        ("memory of the joining process", f"{sizes.upper_bytes / GIB:.0f} GiB"),
        ("memory of all others together, nothing computed twice", f"{held / GIB:.0f} GiB"),
        ("processor time of the parts", f"{of_parts:.1f} h"),
        ("processor time of joining", f"{of_upper:.1f} h"),
    ]
    text = MILLION_TEXT.format(strips=MILLION[0], each=MILLION[1], rays=RAYS * count / 1e6, times=times)
    hours = [(cores, f"{of_parts / cores + of_upper:.1f}") for cores in (2, 16, 64)]
    return [
        *text.splitlines(),
        "",
        *table("what | of a million images", counted),
        *table("cores for the parts | hours, where joining and parts do not overlap", hours),
        *LIMITS.splitlines(),
    ]


if __name__ == "__main__":
    main()
