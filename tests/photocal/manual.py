"""The folder in which the examples of the manual run: small files under the names that they use."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

import photocal
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly
from tests.photocal.products.test_orthophoto import write_job
from tests.simulated import PLANS
from tests.simulated import fly as simulate

# Those of these functions begin with receivers' raw frames.
OF_A_FLIGHT = ("exposures", "ppk", "read_log", "run_project")
DEMO = Path(photocal.__file__).parent / "demo/dcs460"
_KML = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark><name>field</name><Polygon><outerBoundaryIs><LinearRing>
<coordinates>-51.41,-22.12 -51.40,-22.12 -51.40,-22.13 -51.41,-22.12</coordinates>
</LinearRing></outerBoundaryIs></Polygon></Placemark></kml>
"""


def prepare(folder: Path, block: photocal.Block, result: photocal.Result) -> None:
    """Write what all examples but those of a flight read."""
    shutil.copytree(DEMO, folder / "photocal/demo/dcs460")
    block.write(folder / "block")
    result.write(folder / "run")
    photocal.write_cameras(folder / "cameras.toml", [result.camera()])
    shutil.copy(Path(__file__).parents[2] / "configs/networks/test-field.toml", folder)
    (folder / "field.kml").write_text(_KML, encoding="utf-8")
    (folder / "boards").mkdir()
    for k, view in enumerate(_boards(np.random.default_rng(3))):
        cv2.imwrite(str(folder / f"boards/view{k + 1}.png"), view)
    fly(folder / "flown", np.random.default_rng(5), Errors(), Plan(tie=20))
    (folder / "orthophoto").mkdir()
    write_job(folder / "orthophoto")


def prepare_flight(folder: Path) -> None:
    """Simulate a flight and import what was recorded of it."""
    simulate(folder / "simulated", PLANS / "small.toml", level="observations")
    (folder / "simulated/site").rename(folder / "flight")


def _boards(rng: np.random.Generator) -> list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
    """Pictures of a board of 10 by 7 squares from four sides, by a camera of 900 px."""
    square = 60
    row, column = np.mgrid[: 9 * square, : 12 * square] // square
    texture = np.where((row + column) % 2, 20, 235).astype(np.uint8)
    texture[(row < 1) | (row > 7) | (column < 1) | (column > 10)] = 235
    centred = np.array([[1.0, 0.0, -6.0 * square], [0.0, 1.0, -4.5 * square], [0.0, 0.0, 1.0]])
    lens = np.array([[900.0, 0.0, 480.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]])
    made = []
    for _ in range(4):
        turn = Rotation.from_euler("xyz", rng.uniform(-0.4, 0.4, 3)).as_matrix()
        view = lens @ np.column_stack([turn[:, 0], turn[:, 1], [0.0, 0.0, 1000.0]]) @ centred
        grey = cv2.warpPerspective(texture, view, (960, 720), flags=cv2.INTER_AREA, borderValue=235)
        made.append(np.asarray(cv2.GaussianBlur(grey, (0, 0), 0.7), np.uint8))
    return made
