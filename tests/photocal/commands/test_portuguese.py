"""What the commands print with LANG=pt_BR has no English word; errors may have."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from threading import Event

import cv2
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from photocal.base.errors import NotSignedError
from photocal.commands.cli import COMMANDS, app
from photocal.exchange.exporting import Choices
from photocal.exchange.formats import named
from photocal.findings.texts import catalogue
from photocal.measurement.markers import Board, charuco_board
from tests.docs.texts_table import pages
from tests.photocal.blocks import dcs460
from tests.photocal.measurement.rendering import warped
from tests.photocal.run.test_adopt import made_of

ROOT = Path(__file__).parents[3]
STUDIES = ROOT / "configs" / "studies"
# A word as both languages have it; signs between digits and letters make names.
_WORD = re.compile(r"(?<![\w./\\-])[^\W\d_]{2,}(?![\w/\\-]|\.\w)")
# What is no prose: quoted text, options, commands to copy, keys of files, names with a sign.
_NO_PROSE = re.compile(r"\"[^\"]*\"|`[^`]*`|--[\w-]+|photocal \S+|EPSG:\d+|[\w./-]*[/_\\][\w./-]*")
# Names that the programs and standards have, in whatever language.
NAMES = frozenset(
    (
        "colmap",
        "opf",
        "mis",
        "rot",
        "zrot",
        "spr",
        "paule",
        "mandel",
        "brown",
        "observed",
        "ideal",
        "utc",
        "disc",
        "tank",
    )
)
# They still print English.
ENGLISH = {"localise", "volume"}
# They have tests of their own: with data of a flight (`test_guide`), or of what the machine has.
ELSEWHERE = {"ortho", "new", "run", "debrief", "ppk", "exposures", "survey", "doctor", "fetch-grids", "check"}


@cache
def english() -> frozenset[str]:
    """Words of the documentation and of the English catalogue that no Portuguese text has."""
    prose = "\n".join(path.read_text(encoding="utf-8") for path in pages())
    prose = re.sub(r"```.*?```|`[^`]*`|\]\([^)]*\)", " ", prose, flags=re.DOTALL)
    # One by one: a text may have one quotation mark, as of inches.
    ours, theirs = (
        set[str]().union(
            *(words(re.sub(r"\{[^}]*\}", " ", text)) for text in catalogue(language).messages.values())
        )
        for language in ("en", "pt-BR")
    )
    of_studies = words("\n".join(path.read_text(encoding="utf-8") for path in STUDIES.glob("*/study.toml")))
    return frozenset((words(prose) | ours | of_studies) - theirs - NAMES) - _portuguese_of_studies()


@cache
def _portuguese_of_studies() -> frozenset[str]:
    from photocal.report.studies.study import read_study, shipped

    said = (text for folder in shipped().values() for text in read_study(folder).languages["pt-BR"].values())
    return frozenset(words("\n".join(said)))


def words(text: str) -> set[str]:
    return {word.lower() for word in _WORD.findall(_NO_PROSE.sub(" ", text))}


# Tilts of the views of a board, degrees.
TILTS = ((35, 0), (-35, 0), (0, 35), (0, -35), (25, 25), (-25, 25), (0, 0))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A block, its adjustment, analysis, certificate, and pictures of a board."""
    folder = tmp_path_factory.mktemp("pt")
    dcs460(folder / "block")
    board = Board(7, 5, 0.03, "charuco", dictionary="4x4_50")
    texture = np.asarray(charuco_board(board).generateImage((1400, 1000), marginSize=0), np.uint8)
    texture = np.pad(texture, 100, constant_values=255)
    (folder / "fotos").mkdir()
    for k, tilt in enumerate(TILTS):
        turn = cv2.Rodrigues(np.radians([*tilt, 20.0 * k]))[0]
        centre = np.array([0, 0, 2400.0]) - turn[:, :2] @ [800, 600]
        lens = np.array([[900.0, 0, 380], [0, 900.0, 350], [0, 0, 1]])
        picture = warped(texture, lens @ np.column_stack([turn[:, :2], centre]), (760, 700))
        Image.fromarray(picture).save(folder / "fotos" / f"v{k}.png")
    (folder / "uniforme").mkdir()
    Image.new("L", (60, 40), 120).save(folder / "uniforme" / "u.png")
    (folder / "projeto").mkdir()
    named("opf").write(folder / "projeto", made_of("brown-ideal", tmp_path_factory), Choices())
    cameras = (STUDIES / "canon-elph" / "calibrations.toml").read_text(encoding="utf-8").split("[[camera]]")
    (folder / "cameras.toml").write_text("[[camera]]".join(cameras[:3]), encoding="utf-8")
    sets = (f"1,{n},{p},{10 * p + 0.004 * n},5,{7 + 0.2 * p}" for n in range(1, 6) for p in (1, 2))
    (folder / "sets.csv").write_text("\n".join(["series,set,point,E,N,h", *sets]) + "\n", encoding="utf-8")
    hill = (f"{x},{y},{0.1 * x + 0.02 * y * y}" for x in range(9) for y in range(9))
    (folder / "hill.csv").write_text("\n".join(["X,Y,Z", *hill]) + "\n", encoding="utf-8")
    (folder / "area.csv").write_text("lat_deg,lon_deg\n-22.12,-51.41\n-22.12,-51.408\n-22.1215,-51.408\n")
    return folder


CAMERA = "--focal-mm 8.8 --pixel-um 2.41 --image-px 5472x3648"
HOME = "--home -22.121,-51.409,400 --ground-height 405"
# In the order in which they are run.
CASES = (
    "adjust block -o ajuste",
    "analyse ajuste",
    "analyse ajuste --details",
    "certificate ajuste -o certificado",
    "verify certificado",
    "keys",
    "keys --new Laboratorio",
    "sign certificado",
    "verify certificado",
    "export ajuste --format colmap -o colmap",
    "adopt projeto -o adotado",
    "compare cameras.toml",
    f"plan area.csv -o plano {CAMERA} --gsd-cm 3 --scale 1:1000 --no-simulation",
    f"plan area.csv -o vento {CAMERA} --height 90 --wind 6,220 {HOME}",
    "plan-network {root}/configs/networks/test-field.toml",
    "flown block --run ajuste",
    "measure --images fotos --board 7x5 --charuco 4x4_50 -o tabuleiro",
    "mark --images fotos -o marks.csv",
    "desk .",
    "rover-test sets.csv --distance 10 --height-difference 0.2 --sigma 0.010,0.015",
    "contours hill.csv --interval 0.5 -o curvas.dxf --cell 0.5 --heights local",
    "radiometry --flat uniforme -o radiometria.toml",
    "forms -o forms.pdf --kinds station",
    "targets disc -o disc.pdf",
    "study",
    "study ixus220 -o ixus220",
)


# A result that does not stand ends so: what is printed before is said in Portuguese, the error need not be.
REFUSALS = (NotSignedError,)


def test_every_command_is_walked() -> None:
    walked = {line.partition(" ")[0] for line in CASES}
    assert walked | ELSEWHERE | ENGLISH == COMMANDS.keys()
    assert not walked & (ELSEWHERE | ENGLISH)


def test_english_words_are_seen() -> None:
    """What the commands printed before they had a catalogue."""
    for line in ("4 images show the board", "camera main: the same model, nothing lost", "written to plano"):
        assert words(line) & english()
    assert not words("gravado em ajuste, 3 imagens; photocal adjust bloco -o AJUSTE") & english()


def test_no_command_prints_english_in_portuguese(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("LC_ALL", "LC_MESSAGES"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("LANG", "pt_BR.UTF-8")
    monkeypatch.setenv("HOME", str(made))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(made / "settings"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(made / "cache"))
    monkeypatch.chdir(made)
    stopped = Event()
    stopped.set()
    monkeypatch.setattr("photocal.base.operating_system.stopped_by_signals", lambda: stopped)
    found = dict[str, object]()
    for line in CASES:
        printed = CliRunner().invoke(app, line.format(studies=STUDIES, root=ROOT).split())
        ended = printed.exit_code == 0 or isinstance(printed.exception, REFUSALS)
        known = words(printed.stdout) & english()
        if known or not printed.stdout.strip() or not ended:
            found[line] = sorted(known), printed.output, printed.exception
    assert found == {}
