"""Long study: do the standard deviations of a laboratory's calibration hold, from readings and from pictures?

Writes `docs/evidence/laboratory.md`. Twenty pictures of sixty targets, each read at its four corners five
times, three tape distances, no surveyed coordinates; and the same laboratory rendered, measured and adjusted
by the one command.

Run: `make evidence`, or `python -m tests.evidence.laboratory [DRAWS]`.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy import stats

from photocal.adjustment.adjust import adjust
from photocal.base.arrays import Floats
from photocal.base.chi_square import global_test
from photocal.base.progress import quiet
from photocal.base.workers import run_tasks
from photocal.block.results.adjusted import adjust_block
from photocal.geometry.camera import PARAMETERS
from photocal.measurement.image_file import list_images
from photocal.measurement.maker_camera import with_lens
from photocal.measurement.target_block import measure_field
from tests.photocal.measurement.laboratory import (
    ESTIMATED,
    LENS,
    TAPE_SIGMA_M,
    laboratory,
    observed,
    tapes,
    write_pictures,
)

DRAWS = 100
FIELDS = range(5, 13)
PROCESSES = 2
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "laboratory.md"


def drawn(seed: int) -> tuple[Floats, float, bool]:
    """Standardised errors of the camera, v'Pv over its degrees of freedom, and whether it is accepted."""
    solution = adjust(observed(laboratory(), seed))
    at = [PARAMETERS.index(name) for name in ESTIMATED]
    truth = np.array([LENS.get(name, 0.0) for name in ESTIMATED])
    sigma = np.sqrt(np.diag(solution.camera_covariance[0])[at])
    test = global_test(solution.chi_squared, solution.degrees_of_freedom)
    return (solution.cameras[0, at] - truth) / sigma, solution.variance_factor, bool(test and test.accepted)


def rendered(seed: int) -> tuple[Floats, int, int, float]:
    """Find the camera from pictures by the command's own functions, at poses and with noise of a seed.

    returns: its standardised errors; corners used; corners rejected; common sigma of a corner, px.
    """
    lab = laboratory(seed=seed)
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        write_pictures(lab, place / "pictures", seed)
        rows = [f"{a},{b},{v:.5f},{TAPE_SIGMA_M}" for a, b, v in tapes(lab, np.random.default_rng(seed))]
        (place / "tape.csv").write_text("\n".join(["from,to,value,sigma", *rows]) + "\n", encoding="utf-8")
        paths = list_images(place / "pictures")
        found = measure_field(paths, "4x4_100", place / "tape.csv", "lab", with_lens, place / "cache", quiet)
        (place / "block").mkdir()
        found.write(place / "block")
        own = adjust_block(place / "block", place / "run").cameras["camera"]
    away = [(own.value(name) - LENS.get(name, 0.0)) / own.sigma_of(name) for name in ESTIMATED]
    record, used = found.record, len(found.block.observations.image)
    return np.array(away), used, len(record["rejected"]), record["common_sigma_px"]


def rendered_lines(fields: list[tuple[Floats, int, int, float]]) -> list[str]:
    """Each field's errors, their mean and root mean square, and what is to be expected of them."""
    errors = np.array([one[0] for one in fields])
    n = len(fields)
    low, high = (float(np.sqrt(stats.chi2.ppf(p, n) / n)) for p in (0.025, 0.975))
    rms = np.sqrt(np.mean(errors**2, axis=0))
    used, rejected = (sum(one[k] for one in fields) for k in (1, 2))
    common = np.sqrt(np.mean([one[3] ** 2 for one in fields]))
    heads = [f"{k + 1}" for k in range(n)]
    return [
        f"Then {n} fields in rendered pictures, each with its own target positions, noise and tape",
        f"distances: errors divided by their sigmas. If the sigmas are true, the rms of {n} lies between",
        f"{low:.2f} and {high:.2f} and their mean within {1.96 / np.sqrt(n):.2f}, each in 95 of 100 cases.",
        "",
        f"| rendered | {' | '.join(heads)} | mean | rms |",
        "|---" * (n + 3) + "|",
        *(
            f"| {name} | {' | '.join(f'{e:+.2f}' for e in errors[:, k])} | {errors[:, k].mean():+.2f} |"
            f" {rms[k]:.2f} |"
            for k, name in enumerate(ESTIMATED)
        ),
        "",
        f"All: rms {np.sqrt(np.mean(errors**2)):.2f} sigma. {used} corners used, {rejected} rejected;",
        f"common sigma of a corner {common:.4f} px. Neighbouring corners share an edge, whose ends are",
        "correlated by -0.5. They are treated as independent, which errs on the safe side: simulated",
        "readings with this correlation leave an rms of 0.7.",
    ]


def main(draws: int = DRAWS) -> None:
    """Draw, adjust, count, and write the page."""
    found = []
    for seed, one in enumerate(run_tasks(drawn, range(draws), PROCESSES)):
        found.append(one)
        sys.stderr.write(f"\rdraw {seed + 1} of {draws}   ")
    errors = np.array([one[0] for one in found])
    inside = np.abs(errors) < stats.norm.isf(0.025)
    accepted = sum(one[2] for one in found)
    factor, rms = np.mean([one[1] for one in found]), np.sqrt(np.mean(errors**2))
    fields = []
    for seed, field in zip(FIELDS, run_tasks(rendered, FIELDS, PROCESSES), strict=True):
        fields.append(field)
        sys.stderr.write(f"\nfield {seed}: {np.round(fields[-1][0], 2)} {fields[-1][1:]}")
    lines = [
        "# Laboratory",
        "",
        "Sixty targets without coordinates, four corners each, twenty pictures, three tape distances of",
        f"0.5 mm, five readings of 0.3 px; {draws} draws. Coverage: of the 95 % intervals.",
        "",
        "| parameter | coverage | largest error, sigma | rms, sigma |",
        "|---|---|---|---|",
        *(
            f"| {name} | {100 * inside[:, k].mean():.0f} % | {np.abs(errors[:, k]).max():.1f} |"
            f" {np.sqrt(np.mean(errors[:, k] ** 2)):.2f} |"
            for k, name in enumerate(ESTIMATED)
        ),
        f"| all | {100 * inside.mean():.1f} % | {np.abs(errors).max():.1f} | {rms:.2f} |",
        "",
        f"v'Pv over its degrees of freedom {factor:.4f}; the global test accepts {accepted} of {draws}.",
        "",
        *rendered_lines(fields),
    ]
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.stderr.write(f"\nwritten to {OUTPUT}\n")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
