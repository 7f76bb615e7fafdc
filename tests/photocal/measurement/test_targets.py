"""Target sheets: rendered by another program, found by our detectors, true to scale."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.measurement.markers import find_board, find_markers, parse_board
from photocal.measurement.target_search import cross_centre, round_centre, saddle_centre
from photocal.measurement.target_shapes import coded_target, plain_target, sheets_pdf

# Rendered finely, for the renderer puts edges on whole pixels, and taken together as a sensor does.
DPI, FINER = 72, 5
PX_PER_MM = DPI / 25.4
# A target's middle on an A4 sheet, px: pixel centres at whole numbers.
MIDDLE = np.array([210 / 2, (297 - 22) / 2]) * PX_PER_MM - 0.5
Grey = NDArray[np.uint8]

pytestmark = pytest.mark.skipif(
    shutil.which("pdftoppm") is None, reason="pdftoppm (poppler) is not installed"
)


class Answer(Protocol):
    """What a command said."""

    code: int
    out: str
    err: str


def _pages(pdf: Path) -> list[Grey]:
    subprocess.run(["pdftoppm", "-r", str(DPI * FINER), "-gray", pdf, pdf.with_suffix("")], check=True)
    paths = sorted(pdf.parent.glob(f"{pdf.stem}-*.pgm"))
    return [_picture(np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)) for path in paths]


def _picture(page: Grey) -> Grey:
    height, width = (side // FINER * FINER for side in page.shape)
    coarse = page[:height, :width].reshape(height // FINER, FINER, width // FINER, FINER).mean(axis=(1, 3))
    return np.asarray(np.round(cv2.GaussianBlur(coarse, (0, 0), 0.7)), np.uint8)


def _page(tmp_path: Path, photocal: Callable[..., Answer], kind: str, *options: object) -> Grey:
    said = photocal("targets", kind, *options, "-o", tmp_path / f"{kind}.pdf")
    assert said.code == 0, said.err
    (page,) = _pages(tmp_path / f"{kind}.pdf")
    return page


@pytest.mark.parametrize("name", ["apriltag_36h11", "4x4_50", "aruco_mip_36h12"])
def test_coded_targets(name: str, tmp_path: Path, photocal: Callable[..., Answer]) -> None:
    said = photocal("targets", name, "--numbers", "3,7-8", "--size-mm", 40, "-o", tmp_path / "t.pdf")
    assert said.code == 0, said.err
    pages = _pages(tmp_path / "t.pdf")
    found = [find_markers(page, name) for page in pages]
    assert [[m.identity for m in one] for one in found] == [[3], [7], [8]]
    for (marker,) in found:
        place = (marker.centre.column, marker.centre.row)
        assert place == pytest.approx(tuple(MIDDLE), abs=0.1)
        sides = np.hypot(*(np.roll(marker.corners, -1, axis=0) - marker.corners).T)
        assert sides == pytest.approx(40 * PX_PER_MM, rel=0.002)


@pytest.mark.parametrize("kind", ["chessboard", "charuco"])
def test_boards(kind: str, tmp_path: Path, photocal: Callable[..., Answer]) -> None:
    page = _page(tmp_path, photocal, kind, "--size-mm", 18, "--board", "8x6")
    board = parse_board("8x6", 0.018, "4x4_50" if kind == "charuco" else "")
    view = find_board(page, board)
    assert view is not None
    corners, pixels, _ = view
    assert len(corners) == 35
    # A similarity takes the board to the page: its scale is that of the paper.
    flat = board.points()[corners, :2] * [1, -1]
    zoom = np.linalg.lstsq(flat - flat.mean(axis=0), pixels - pixels.mean(axis=0), rcond=None)[0]
    assert np.sqrt(abs(np.linalg.det(zoom))) == pytest.approx(1000 * PX_PER_MM, rel=5e-4)


def test_plain_targets(tmp_path: Path, photocal: Callable[..., Answer]) -> None:
    near = (float(MIDDLE[0]) + 2, float(MIDDLE[1]) - 1)
    reach = 20 * PX_PER_MM
    pages = {
        kind: _page(tmp_path, photocal, kind, "--size-mm", 40)
        for kind in ("disc", "ring", "cross", "hourglass")
    }
    centres = {
        "disc": round_centre(pages["disc"], near, (reach, reach)),
        "ring": round_centre(pages["ring"], near, (reach / 2, reach / 2)),
        "cross": cross_centre(pages["cross"], near, 2 * reach),
        "hourglass": saddle_centre(pages["hourglass"], near, 0.6 * reach),
    }
    for kind, centre in centres.items():
        assert centre is not None, kind
        assert (centre.column, centre.row) == pytest.approx(tuple(MIDDLE), abs=0.1), kind
    assert centres["disc"] is not None
    assert centres["cross"] is not None
    assert centres["ring"] is not None
    assert centres["disc"].shape[:2] == pytest.approx(reach, rel=0.002)
    assert centres["ring"].shape[:2] == pytest.approx(reach / 2, rel=0.004)
    # The bars are a fifth as wide as long; the renderer widens edges to its own pixels.
    assert centres["cross"].shape[2] == pytest.approx(2 * reach / 5, abs=0.2)


def test_the_bar_is_100_mm_long(tmp_path: Path, photocal: Callable[..., Answer]) -> None:
    page = _page(tmp_path, photocal, "disc")
    row = round((297 - 22 + 6) * PX_PER_MM - 0.5)
    dark = np.flatnonzero(page[row - 2 : row + 3].min(axis=0) < 200)
    assert dark[-1] - dark[0] == pytest.approx(100 * PX_PER_MM, abs=2)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("star",), "is not known"),
        (("disc", "--size-mm", 200), "use --paper a3"),
        (("apriltag_36h11", "--numbers", "587"), "its numbers are 0 to 586"),
        (("apriltag_36h11", "--numbers", "x"), "are not understood"),
        (("disc", "--paper", "letter"), "paper 'letter' is not known"),
    ],
)
def test_refusals(
    words: tuple[object, ...], said: str, tmp_path: Path, photocal: Callable[..., Answer]
) -> None:
    answer = photocal("targets", *words, "-o", tmp_path / "t.pdf")
    assert answer.code != 0
    assert said in answer.err
    assert not (tmp_path / "t.pdf").exists()


def test_the_example_of_the_help_works(tmp_path: Path, photocal: Callable[..., Answer]) -> None:
    (example,) = re.findall(
        r"`photocal (targets [^`]*)`", " ".join(photocal("targets", "--help").out.split())
    )
    assert photocal(*example.replace("targets.pdf", str(tmp_path / "t.pdf")).split()).code == 0


def test_sheets_have_the_name_of_a_pdf(tmp_path: Path, photocal: Callable[..., Answer]) -> None:
    for command in (("targets", "disc"), ("forms",)):
        answer = photocal(*command, "-o", tmp_path / "sheets.docx")
        assert "sheets.docx has no known extension; use .pdf" in answer.err
    assert list(tmp_path.iterdir()) == []


def test_sheets_are_the_same_each_time() -> None:
    sheets = [coded_target("apriltag_36h11", 1, 100), plain_target("cross", 80)]
    assert sheets_pdf(sheets, "a4") == sheets_pdf(sheets, "a4")


def test_a_small_code_is_found_in_a_large_image() -> None:
    """Two pixels and more a cell are enough, whatever the size of the image around it."""
    codes = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    picture = np.full((3000, 4000), 120, np.uint8)
    truth = {}
    for code, side in enumerate((16, 20, 30)):
        fine = np.full((side + 12, side + 12), 255, np.uint8).repeat(8, axis=0).repeat(8, axis=1)
        drawn = codes.generateImageMarker(code, 8).repeat(side, axis=0).repeat(side, axis=1)
        fine[48 : 48 + 8 * side, 48 : 48 + 8 * side] = drawn
        plate = cv2.resize(
            cv2.GaussianBlur(fine, (0, 0), 5), None, fx=1 / 8, fy=1 / 8, interpolation=cv2.INTER_AREA
        )
        row, column = 700 * code + 333, 1100 * code + 501
        picture[row : row + side + 12, column : column + side + 12] = plate
        truth[code] = (column + (side + 11) / 2, row + (side + 11) / 2)
    found = {m.identity: (m.centre.column, m.centre.row) for m in find_markers(picture, "apriltag_36h11")}
    assert found.keys() == truth.keys()
    for code, place in truth.items():
        assert found[code] == pytest.approx(place, abs=0.05)
