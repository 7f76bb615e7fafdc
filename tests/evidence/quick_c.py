"""Study: is the standard deviation of c in the first calibration of a debrief honest?

Writes `docs/evidence/quick_c.md`. Flights of the simulated test field are seen by tie points of reduced
pictures, and c is released as a debrief does: beside the principal point alone, and with what else c depends
on (pixels that are not square, a lens out of centre, a shutter that rolls and what gusts move in it).

Run: `make evidence`, or `python -m tests.evidence.quick_c [FLIGHTS]`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from acquire.simulate.world.configuration import read_configuration
from photocal.exchange.pinhole import Pinhole, from_pinhole
from photocal.geometry.camera import among
from photocal.measurement.released_c import told_by_rays, with_released_c
from photocal.measurement.tie_adjustment import AdjustedTies, adjust_ties, reopened, shutters_closed
from photocal.measurement.tie_block import tracks_of
from photocal.run.debrief.pictures import ALSO
from tests.simulated import FLIGHT, block_of, true_poses, world_of

OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "quick_c.md"
FLIGHTS = 20
# Of features in pictures of 1824 px that are reduced to 640 px, px; of single-frequency receivers, m.
SIGMA_PX, POSITION_M = 0.8, np.array([1.5, 1.5, 3.0])
# Ratio of the sides of a pixel, and readout, s.
CAMERAS = {
    "square pixels": (1.0, 0.0),
    "sides that differ by 0.05 %": (1.0005, 0.0),
    "readout of 10 ms": (1.0, 0.01),
    "readout of 30 ms": (1.0, 0.03),
}


def adjusted(seed: int, sides: float, readout_s: float) -> tuple[AdjustedTies, float]:
    """A flight as reduced pictures orient it, with c held 0.4 % off, and the true c, mean of both sides."""
    camera = read_configuration(FLIGHT).camera.model_dump(exclude_unset=True)
    camera["fx"], camera["readout_s"] = sides * camera["fy"], readout_s
    observing: dict[str, Any] = {"sigma_px": SIGMA_PX, "ties": 1200}
    world = world_of(FLIGHT, seed=seed, camera=camera, observing=observing)
    c = 0.5 * (camera["fx"] + camera["fy"])
    size = camera["size_px"]
    nominal = Pinhole(size, 1.004 * c, 1.004 * c, (size[0] - 1) / 2, (size[1] - 1) / 2)
    own = replace(from_pinhole(nominal, "SIM-1", "stated"), estimated=among("K1", "K2"), shutter="unknown")
    block = block_of(world, own, POSITION_M, np.random.default_rng(seed))
    _, tracks = tracks_of(block.observations, np.ones(len(block.observations.image), dtype=np.bool_))
    nothing = np.zeros(0, dtype=np.int64)
    start = replace(block, points=block.points.only(nothing), observations=block.observations.rows(nothing))
    start = replace(start, cameras=shutters_closed(start.cameras))
    return reopened(adjust_ties(start, true_poses(world), tracks), block.cameras), c


def errors(flights: int, sides: float, readout_s: float) -> Iterator[tuple[float, float, float, float]]:
    """Error and standard deviation of c, px, of each flight: beside the principal point, and as released."""
    for seed in range(1, flights + 1):
        made, c = adjusted(seed, sides, readout_s)
        row = []
        for also in ((), ALSO):
            told = told_by_rays(with_released_c(made, 1.0, also), with_released_c(made, 10.0, also))
            assert told is not None, seed
            row += [told.cameras[0, 0] - c, float(np.sqrt(told.camera_covariance[0, 0, 0]))]
        yield row[0], row[1], row[2], row[3]


def main() -> None:
    """Run the study and write its page."""
    flights = int(sys.argv[1]) if len(sys.argv) > 1 else FLIGHTS
    lines = [
        "# c of the first calibration in a debrief",
        "",
        f"{flights} simulated flights of the test field for each camera (42 pictures at two heights, strips",
        f"that cross), rays of {SIGMA_PX:g} px in pictures of 1824 px, positions of 1.5 and 3 m. rms: of the",
        "error of c over its standard deviation, expected 1; 95 of 100 studies of 20 give 0.69 to 1.31.",
        "",
        "| camera | released with c | mean error, px | its standard error | sigma, px | rms |",
        "|---|---|---|---|---|---|",
    ]
    for name, (sides, readout_s) in CAMERAS.items():
        found = np.array([*errors(flights, sides, readout_s)])
        for released, (error, sigma) in {
            "x0, y0": found[:, :2].T,
            "x0, y0, P1, P2, B1, readout": found[:, 2:].T,
        }.items():
            figures = [error.mean(), error.std(ddof=1) / np.sqrt(flights), np.median(sigma)]
            rms = float(np.sqrt(np.mean((error / sigma) ** 2)))
            lines.append(f"| {name} | {released} | " + " | ".join(f"{x:.2f}" for x in (*figures, rms)) + " |")
    lines += ["", "Made by `python -m tests.evidence.quick_c`.", ""]
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")
    sys.stderr.write("\n".join(lines))


if __name__ == "__main__":
    main()
