"""`photocal compare` and the files of cameras that it takes."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from photocal.analysis.stability.camera_file import read_camera_file
from photocal.analysis.stability.comparison import compare
from photocal.analysis.stability.methods import ResectionGround, methods, sensor_grid
from photocal.analysis.stability.pictures import displacements, without_term
from photocal.base.errors import (
    ConfigurationError,
    InputNotFoundError,
    PhotocalError,
)
from photocal.commands.cli import app
from photocal.geometry.camera import camera

STUDY = Path(__file__).parents[3] / "configs/studies/canon-elph/calibrations.toml"
GRID = sensor_grid((4000, 3000), 250.0)
CHOSEN = methods(len(GRID), (ResectionGround(height_m=250.0, relief_m=100.0),), 2, 5)
ENTRY = '[[camera]]\nid = "{}"\nmodel = "brown-observed"\nunit = "px"\nsize_px = [400, 300]\n'
GOOD = ENTRY.format("a") + "parameters = { c = 350.0 }\n" + ENTRY.format("b") + "parameters = { c = 351.0 }\n"


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("", InputNotFoundError, "is empty"),
        ("[[camera", ConfigurationError, "is not valid TOML"),
        (GOOD.replace("unit", "units", 1), ConfigurationError, "unknown key camera.1.units"),
        (GOOD.replace('unit = "px"', 'unit = "mm"', 1), ConfigurationError, "pitch_mm is missing"),
        (
            GOOD.replace("c = 350", "cc = 350"),
            ConfigurationError,
            "names cc, which is not a camera parameter",
        ),
        (
            GOOD.replace("c = 350", "c = -350"),
            ConfigurationError,
            "c is missing or not positive",
        ),
        (GOOD.replace("c = 350.0", "c = nan"), ConfigurationError, "finite number"),
        (GOOD + "sigma = { c = -1.0 }\n", ConfigurationError, "greater than 0"),
        (
            GOOD + "sigma = { z = 1.0 }\n",
            ConfigurationError,
            "sigma names z, which is not a camera parameter",
        ),
        (
            GOOD + 'correlation = { names = ["c"], matrix = [[1.0]] }\n',
            ConfigurationError,
            "has correlations but no sigma",
        ),
        (
            GOOD + 'sigma = { c = 1.0 }\ncorrelation = { names = ["c"], matrix = [[1.0, 0.0]] }\n',
            ConfigurationError,
            "correlation matrix is not 1 by 1",
        ),
        (
            GOOD.replace("c = 351.0", "c = 351.0, x0 = 1.0, y0 = 1.0")
            + "sigma = { c = 1.0, x0 = 1.0, y0 = 1.0 }\n"
            + 'correlation = { names = ["c", "x0", "y0"], '
            + "matrix = [[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]] }\n",
            ConfigurationError,
            "not positive definite",
        ),
        (
            "[comparison]\nterrain = [{ height_m = 50.0, relief_m = 60.0 }]\n" + GOOD,
            ConfigurationError,
            "reaches the exposure",
        ),
    ],
)
def test_wrong_files_are_refused_in_one_line(
    tmp_path: Path, text: str, kind: type[PhotocalError], message: str
) -> None:
    path = tmp_path / "cameras.toml"
    path.write_text(text)
    with pytest.raises(kind, match=message) as caught:
        read_camera_file(path)
    assert "cameras.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


@settings(max_examples=60)
@given(st.integers(0, len(GOOD) - 1), st.binary(max_size=6))
def test_damaged_files_are_refused_or_read(
    tmp_path_factory: pytest.TempPathFactory, at: int, put: bytes
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "cameras.toml"
    path.write_bytes(GOOD.encode()[:at] + put + GOOD.encode()[at + 1 :])
    with contextlib.suppress(PhotocalError):
        read_camera_file(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD[: GOOD.index("[[camera]]", 5)], "1 calibration cannot be compared"),
        (GOOD.replace('"b"', '"a"'), "camera a occurs twice"),
        (GOOD.replace("400", "401", 1), "has 400 x 300 px, camera a has 401 x 300 px"),
    ],
)
def test_cameras_that_cannot_be_compared(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "cameras.toml").write_text(text)
    asked = read_camera_file(tmp_path / "cameras.toml")
    with pytest.raises(ConfigurationError, match=message):
        compare(asked.calibrations, GRID, CHOSEN, np.random.default_rng(1))


def test_the_command_answers_in_json_and_draws(tmp_path: Path) -> None:
    path, picture = tmp_path / "cameras.toml", tmp_path / "pairs.png"
    path.write_text(GOOD + "sigma = { c = 0.5 }\n")
    done = CliRunner().invoke(app, ["compare", str(path), "--json", "--picture", str(picture)])
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    assert figures["schema"] == "photocal.comparison/1"
    (pair,) = figures["pairs"]
    assert (pair["first"], pair["second"]) == ("a", "b")
    assert pair["figures"][0]["sigma_px"] is None  # camera a has no sigmas
    assert {f["method"] for f in pair["figures"]} == {"MIS", "ZROT", "ROT", "SPR"}
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_command_answers_in_words(tmp_path: Path) -> None:
    path = tmp_path / "cameras.toml"
    one = GOOD[: GOOD.index("[[camera]]", 5)] + "sigma = { c = 0.5 }\n"
    path.write_text(one + one.replace('"a"', '"b"').replace("350.0", "355.0"))
    done = CliRunner().invoke(app, ["compare", str(path)])
    assert done.exit_code == 0, done.output
    assert "ZROT, mean distance, px" in done.stdout
    assert "differ beyond their noise" in done.stdout


def test_pictures_speak_the_language_of_the_reader(tmp_path: Path) -> None:
    path, drawn = tmp_path / "cameras.toml", [tmp_path / f"{name}.svg" for name in ("a", "b", "c")]
    path.write_text(GOOD.replace("351.0 }", "351.0 }\nsigma = { c = 0.5 }"), encoding="utf-8")
    options = zip(("--picture", "--curves", "--parameters"), map(str, drawn), strict=True)
    given = [word for pair in options for word in pair]
    done = CliRunner().invoke(app, ["compare", str(path), *given, "--lang", "pt-BR"])
    assert done.exit_code == 0, done.stderr
    said = "\n".join(one.read_text(encoding="utf-8") for one in drawn)
    for words in ("Diferença entre calibrações", "distorção radial", "pontos principais, px", "c, px"):
        assert words in said
    assert not any(words in said for words in ("calibrations", "distortion", "principal points", "longest"))


def test_a_picture_of_unknown_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cameras.toml"
    path.write_text(GOOD)
    done = CliRunner().invoke(app, ["compare", str(path), "--picture", str(tmp_path / "pairs.doc")])
    assert isinstance(done.exception, ConfigurationError)
    assert list(tmp_path.iterdir()) == [path]


def test_curves_of_several_calibrations(tmp_path: Path) -> None:
    picture, path = tmp_path / "curves.png", tmp_path / "cameras.toml"
    shown = tmp_path / "parameters.png"
    path.write_text(GOOD.replace("c = 351.0", "c = 351.0, K1 = 1e-7, K3 = 1e-17") + "sigma = { c = 0.5 }\n")
    arguments = ["compare", str(path), "--json", "--curves", str(picture), "--parameters", str(shown)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert shown.read_bytes().startswith(b"\x89PNG")


def test_a_term_that_is_dropped_is_taken_over_by_the_others() -> None:
    """As the normal equations without it: values of the others by the covariance, by hand."""
    own = read_camera_file(STUDY).calibrations[0]
    names = [name for name in own.free if own.sigma_of(name) > 0]
    covariance, out = own.covariance_of(names), names.index("K3")
    left = without_term(own, "K3")
    assert left.value("K3") == 0.0
    for i, name in enumerate(names):
        if name != "K3":
            moved = covariance[i, out] / covariance[out, out] * own.value("K3")
            assert left.value(name) == pytest.approx(own.value(name) - moved, rel=1e-9)


def test_displacements_are_those_of_the_polynomials() -> None:
    """At 45 degrees right of and below the principal point: K1 r^3 outwards; decentring by hand."""
    k1, p1 = -2e-8, 3e-7
    values = {"c": 1500.0, "x0": 0.0, "y0": 0.0, "K1": k1, "P1": p1}
    own = camera("a", "brown-observed", "px", (1001, 801), (1.0, 1.0), values)
    found = displacements(own, np.array([[500.0 + 300.0, 400.0 + 300.0]]))
    r2 = 2 * 300.0**2
    assert found["radial"][0] == pytest.approx([k1 * r2 * 300.0, k1 * r2 * 300.0])
    # x = 300, y = -300 (up): P1 (r2 + 2 x2) to the right, 2 P1 x y up, which is down when it is negative.
    assert found["decentring"][0] == pytest.approx([p1 * (r2 + 2 * 9e4), 2 * p1 * 9e4])
    assert found["total"] == pytest.approx(found["radial"] + found["decentring"])
