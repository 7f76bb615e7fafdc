"""Published figures of the studies, read from the tables beside the tests."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from photocal.analysis.estimates import Estimates, from_sigmas

PUBLISHED = Path(__file__).parent / "published"
# The study's names: f, A and B; ours: c, B1 and B2.
NAMES = {"f": "c", "A": "B1", "B": "B2"}

Rows = list[dict[str, str]]


def read_rows(path: Path) -> Rows:
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="session")
def canon() -> Callable[[str], Rows]:
    """Reader of the tables of the Canon ELPH study (FCT-UNESP)."""
    return lambda name: read_rows(PUBLISHED / "canon_elph" / f"{name}.csv")


@pytest.fixture(scope="session")
def tank() -> Callable[[str], Rows]:
    """Reader of the tables of the tank study (UFPR, 1995)."""
    return lambda name: read_rows(PUBLISHED / "tank" / f"{name}.csv")


@pytest.fixture(scope="session")
def canon_sets(canon: Callable[[str], Rows]) -> dict[str, Estimates]:
    """Tables 6 to 9: the seven sets as printed; Table 12, the correlations of set 1, with set 1."""
    rows = canon("table06_09_iop_sets")
    table = canon("table12_correlation_set1")
    order = [row["parameter"] for row in table]
    correlation = np.array([[float(row[name]) for name in order] for row in table])
    sets = {}
    for name in sorted({row["set"] for row in rows}):
        mine = {row["parameter"]: row for row in rows if row["set"] == name}
        sets[name] = from_sigmas(
            [NAMES.get(p, p) for p in order],
            [float(mine[p]["value"]) for p in order],
            [float(mine[p]["std_dev"]) for p in order],
            correlation if name == "1" else None,
        )
    return sets


def matrix(rows: Rows) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Numbers of a table whose first column is a label."""
    return np.array([[float(value) for value in list(row.values())[1:]] for row in rows])


@pytest.fixture(scope="session")
def dcs460_block(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Block folder of the convergent-camera study with all 12 photographs: the demo block and photo 2."""
    demo = Path(__file__).parents[3] / "photocal/demo/dcs460"
    block = tmp_path_factory.mktemp("dcs460")
    shutil.copytree(demo, block, dirs_exist_ok=True)
    with (block / "images.csv").open("a", encoding="utf-8") as stream:
        stream.write("2,dcs460,-1.280,0.425,6.671,33.50744,-29.95640,107.34141\n")
    rows = read_rows(PUBLISHED / "dcs460" / "image_observations_photo02_reconstructed.csv")
    with (block / "observations.csv").open("a", encoding="utf-8") as stream:
        stream.writelines(f"2,{row['point']},{row['x_mm']},{row['y_mm']}\n" for row in rows)
    return block


@pytest.fixture(scope="session")
def dcs460() -> Callable[[str], Rows]:
    """Reader of the independent adjustments of the convergent-camera study."""
    return lambda name: read_rows(PUBLISHED / "dcs460" / f"{name}.csv")
