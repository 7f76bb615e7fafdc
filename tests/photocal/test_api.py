"""The public face: quick to import, short to print, and its examples run as they stand."""

from __future__ import annotations

import doctest
import inspect
import re
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from matplotlib.figure import Figure

import photocal
from acquire.log.chunk import Channel
from acquire.log.foxglove import location_fixes, schema
from acquire.log.writer import LogWriter
from photocal.base.errors import ConfigurationError
from photocal.base.options import Option, Options
from tests.conftest import needs_engine
from tests.docs.api_page import EXAMPLES, PAGE, page
from tests.photocal import manual

START_NS, FIXES = 1_700_000_000_000_000_000, 50


def flight_log(path: Path) -> None:
    """A receiver's positions at 5 Hz, and its status as JSON with one field left out now and then."""
    times = START_NS + 200_000_000 * np.arange(FIXES)
    unknown = np.full(FIXES, np.nan)
    places = np.full(FIXES, -22.12), np.full(FIXES, -51.41), np.linspace(400.0, 410.0, FIXES)
    fixes = location_fixes("antenna", times, *places, unknown, unknown)
    with path.open("wb") as stream:
        log = LogWriter(stream)
        number = np.arange(FIXES)
        channel = Channel("/gnss/rover/fix", "protobuf", schema("foxglove.LocationFix"))
        log.messages(channel, fixes, times, times, number)
        raw = Channel("/rover/raw", "ubx")
        log.messages(raw, [b"\xb5b"] * FIXES, times, times, number)
        log.close()


def run_example(name: str, folder: Path) -> str:
    command = [sys.executable, "-W", "error", str(EXAMPLES / name)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def numbers(text: str) -> list[float]:
    return [float(one) for one in re.findall(r"[-+]?\d+\.?\d*(?:e[-+]\d+)?", text)]


def test_import_is_quick_and_loads_nothing() -> None:
    heavy = ("numpy", "pyarrow", "pydantic", "numba")
    code = f"import sys, photocal; print([m for m in {heavy} if m in sys.modules])"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert told.strip() == "[]"


def test_what_is_offered_is_there_and_described() -> None:
    for name in dir(photocal):
        assert (getattr(photocal, name).__doc__ or "").strip(), name
    with pytest.raises(AttributeError):
        _ = photocal.nothing_of_this_name
    assert PAGE.read_text(encoding="utf-8") == page(), "run `make manual`"


def test_calibration_from_arrays(tmp_path: Path) -> None:
    example = (EXAMPLES / "calibrate_from_arrays.py").read_text(encoding="utf-8")
    assert len(example.partition("# The calibration.\n")[2].splitlines()) < 10
    told = run_example("calibrate_from_arrays.py", tmp_path)
    c, sigma, truth = numbers(re.findall(r"c is .*", told)[0])
    assert abs(c - truth) < 3.5 * sigma
    assert "accepted" in told


def test_a_scale_bar_and_a_type_of_ones_own_give_the_scale(tmp_path: Path) -> None:
    told = run_example("add_an_observation_type.py", tmp_path)
    free, barred, own = (numbers(line)[-1] for line in told.splitlines())
    assert free == pytest.approx(1.0, abs=0.1)
    assert max(abs(barred), abs(own)) < 0.1


def test_a_kind_without_a_function_is_refused() -> None:
    points = np.random.default_rng(1).uniform(-1, 1, (12, 3))
    block = photocal.block_of_arrays(
        points, np.full((3, 12, 2), 100.0), (640, 480), sigma_px=1.0, sigma_m=0.01
    )
    with pytest.raises(ConfigurationError, match="'length' is not a known kind of observation"):
        photocal.with_relations(block, "length", [("1", "2", 1.0, 0.1)])
    own = photocal.with_relations(block, "length", [("1", "2", 1.0, 0.1)], lambda d: (d[:, 2], d))
    assert own.relations.names[own.relations.kind[0]] == "length"


def test_check_points_tell_the_models_apart(tmp_path: Path) -> None:
    short, long = (numbers(line) for line in run_example("compare_camera_models.py", tmp_path).splitlines())
    assert short[-1] > 5 * long[-1]
    assert "v'Pv / r" in run_example("compare_camera_models.py", tmp_path)


def test_a_refocused_camera_is_told_from_one_that_stayed_the_same(tmp_path: Path) -> None:
    told = run_example("compare_calibrations.py", tmp_path).splitlines()
    assert [line.partition(";")[0] for line in told[3:]] == [
        "March and April: the same",
        "March and May: another camera",
        "April and May: another camera",
    ]


def test_convergence_and_depth_determine_the_principal_distance(tmp_path: Path) -> None:
    """Steeper rays against a flat field tell c: Luhmann, Close-range photogrammetry, on test fields."""
    told = run_example("design_a_network.py", tmp_path).splitlines()
    flat, rolled, steep, deep = (numbers(line)[-1] for line in told)
    assert max(steep, deep) < 0.5 * min(flat, rolled)


def test_flights_scatter_as_the_plan_promises(tmp_path: Path) -> None:
    promised, found = (
        np.array(numbers(line.partition("mm:" if "mm:" in line else "flights:")[2]))
        for line in run_example("monte_carlo_of_a_flight.py", tmp_path).splitlines()
    )
    # Errors of the control are common to the check points of a flight.
    np.testing.assert_allclose(found, promised, rtol=0.35)


def test_a_flight_log_becomes_arrays(tmp_path: Path) -> None:
    flight_log(tmp_path / "flight.mcap")
    told = run_example("read_a_flight_log.py", tmp_path)
    assert "/gnss/rover/fix 50 messages" in told
    assert "/rover/raw" not in told
    assert numbers(told.splitlines()[-1])[:1] == [5.0]
    assert numbers(told.splitlines()[-1])[-2:] == [400.0, 410.0]
    raw = photocal.read_log(tmp_path / "flight.mcap", ["/rover/raw"])
    assert raw["/rover/raw"]["payload"][0] == b"\xb5b"


def block_of(rng: np.random.Generator) -> photocal.Block:
    return photocal.block_of_arrays(
        rng.normal(size=(9, 3)), rng.normal(size=(30, 9, 2)), (40, 30), sigma_px=1.0, sigma_m=None
    )


def test_things_print_as_short_tables() -> None:
    block = block_of(np.random.default_rng(1))
    given = block.images
    images = photocal.OrientedImages(given.names, block.cameras, given.camera, np.zeros((30, 6)))
    shown = ((block, "30 images, 9 points"), (block.cameras[0], "brown-ideal"), (images, "kappa"))
    for thing, words in shown:
        assert words in repr(thing)
        assert "array(" not in repr(thing)
        assert len(repr(thing).splitlines()) < 15


def test_what_steps_give_prints_as_their_commands_do(block: photocal.Block, result: photocal.Result) -> None:
    """The verdict once, errors by method, and no arrays."""
    checked, analysed = photocal.check(block), photocal.analyse(block, result)
    assert repr(analysed).count("Verdict") == 1
    assert "  indirect: " in repr(checked)
    for thing in (checked, analysed):
        assert "array(" not in repr(thing)
        assert len(repr(thing).splitlines()) < 40
    area = photocal.area_from_corners([(-51.41, -22.12), (-51.40, -22.12), (-51.40, -22.13)], "field")
    assert repr(area) == "Area: 3 corners about latitude -22.12500, longitude -51.40500"


def test_arrays_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"shape \(4, 2\)"):
        photocal.block_of_arrays(np.zeros((4, 2)), np.zeros((1, 4, 2)), (4, 3), sigma_px=1.0, sigma_m=None)
    with pytest.raises(ConfigurationError, match="point x is not in the block"):
        photocal.with_relations(block_of(np.random.default_rng(1)), "distance", [("1", "x", 1.0, 0.1)])


FUNCTIONS = [name for name in dir(photocal) if inspect.isfunction(getattr(photocal, name))]


@pytest.fixture(scope="module")
def block() -> photocal.Block:
    """The published observations of a Kodak DCS460."""
    return photocal.read_block(Path(photocal.__file__).parent / "demo" / "dcs460")


@pytest.fixture(scope="module")
def result(block: photocal.Block) -> photocal.Result:
    return photocal.adjust(block)


def sections(text: str) -> dict[str, str]:
    """Parts of a numpydoc docstring by their titles."""
    parts = re.split(r"^(\w[\w ]*)\n-+\n", text, flags=re.MULTILINE)
    return {"Summary": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_have_a_manual(name: str) -> None:
    function = getattr(photocal, name)
    parts = sections(inspect.getdoc(function) or "")
    signature = inspect.signature(function)
    described = re.findall(r"^(\w[\w, ]*)(?: : .*)?\n +\S", parts.get("Parameters", ""), re.MULTILINE)
    told = [one for names in described for one in names.split(", ")]
    assert told == list(signature.parameters), "every parameter in its order"
    assert len(signature.parameters) <= 8 or name == "camera"
    assert signature.return_annotation == "None" or "Returns" in parts
    assert {"Raises", "Examples"} <= parts.keys()
    for error in re.findall(r"^\w+Error", parts["Raises"], re.MULTILINE):
        assert issubclass(getattr(photocal, error), photocal.PhotocalError)


def test_classes_say_what_they_hold() -> None:
    """By an Attributes section, or, of options, by the help that the command line shows."""
    for name in dir(photocal):
        kind = getattr(photocal, name)
        if inspect.isfunction(kind) or issubclass(kind, Exception):
            continue
        assert re.fullmatch(r"[A-Z][^\n]*\.", (inspect.getdoc(kind) or "").splitlines()[0]), name
        if issubclass(kind, Options):
            hints = get_type_hints(kind, include_extras=True)
            own = [hints[field.name] for field in fields(kind)]
            assert all(any(isinstance(part, Option) for part in get_args(hint)) for hint in own), name
        else:
            assert "Attributes\n----------\n" in (inspect.getdoc(kind) or ""), name


@pytest.fixture(scope="module")
def folder(block: photocal.Block, result: photocal.Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the examples of docstrings run."""
    made = tmp_path_factory.mktemp("manual")
    manual.prepare(made, block, result)
    return made


@pytest.fixture(scope="module")
def flown(folder: Path) -> Path:
    """The same with a flight."""
    needs_engine()
    manual.prepare_flight(folder)
    return folder


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("name", FUNCTIONS)
def test_examples_in_docstrings_run(
    name: str,
    block: photocal.Block,
    result: photocal.Result,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(request.getfixturevalue("flown" if name in manual.OF_A_FLIGHT else "folder"))
    example = doctest.DocTestParser().get_doctest(
        inspect.getdoc(getattr(photocal, name)) or "", {"block": block, "result": result}, name, None, 0
    )
    assert example.examples
    assert not any(doctest.SKIP in one.options for one in example.examples)
    assert doctest.DocTestRunner().run(example).failed == 0


def test_a_result_draws_itself_with_units(result: photocal.Result) -> None:
    for draw in (result.plot.residuals, result.plot.camera, result.plot.block):
        figure = draw()
        assert isinstance(figure, Figure)
        labels = [label for ax in figure.axes for label in (ax.get_xlabel(), ax.get_ylabel())]
        with_unit = [label for label in labels if label.endswith((", px", ", mm", ", m"))]
        assert len(with_unit) >= 2
        assert set(labels) - set(with_unit) <= {"standardised residual", "density"}


def test_a_camera_that_is_not_there_is_refused_by_the_names_of_those_that_are(
    result: photocal.Result,
) -> None:
    assert result.camera() is result.camera("dcs460")
    for ask in (result.camera, result.plot.camera, result.plot.residuals):
        with pytest.raises(photocal.PhotocalError, match=r"no camera 'ricoh'.*dcs460"):
            ask("ricoh")
    with pytest.raises(photocal.PhotocalError, match=r"'k1' is not a camera parameter.*K1"):
        photocal.camera("lens", "brown-ideal", "px", (4, 3), (1, 1), {"k1": 1.0})


def test_notebooks_show_short_tables(block: photocal.Block, result: photocal.Result) -> None:
    assert "<td>control points</td><td>40</td>" in block._repr_html_()
    shown = result._repr_html_()
    assert shown.count("<tr>") == 1 + len(result.camera().free)
    assert "accepted" in shown


def test_results_go_round_by_names_as_texts(result: photocal.Result, tmp_path: Path) -> None:
    folder = str(tmp_path / "new" / "run")
    photocal.write_result(folder, result)
    again = photocal.read_result(folder)
    np.testing.assert_array_equal(again.camera().values, result.camera().values)
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(photocal.OutputError):
        photocal.write_result(tmp_path / "file", result)


def test_without_pandas_its_name_is_said(result: photocal.Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(photocal.ProgramMissingError, match="pip install pandas"):
        result.to_pandas()


def test_one_camera_is_the_same_and_a_changed_one_is_not(result: photocal.Result) -> None:
    first = result.camera()
    same = photocal.compare([first, replace(first, id="again")]).pairs[0].figures
    other = replace(first.changed(c=1.05 * first.value("c")), id="other")
    changed = photocal.compare([first, other]).pairs[0].figures
    assert max(figure.value_px for figure in same) == pytest.approx(0.0, abs=1e-6)
    assert max(figure.value_px for figure in changed) > 10.0
    with pytest.raises(photocal.ConfigurationError, match="mixed"):
        photocal.compare([first, "run"])


def test_a_table_without_its_columns_is_refused() -> None:
    with pytest.raises(photocal.ConfigurationError, match="no column dN"):
        photocal.assess({"point": ["a"], "dE": [0.0]})


def test_a_table_in_memory_and_its_file_are_judged_alike(tmp_path: Path) -> None:
    table: dict[str, list[Any]] = {
        "point": ["a", "b", "c", "d"],
        "dE": [0.1, -0.2, 0.3, 0.1],
        "dN": [0.0, 0.1, 0.2, -0.1],
    }
    lines = ["point,dE,dN", *(",".join(map(str, row)) for row in zip(*table.values(), strict=True))]
    (tmp_path / "d.csv").write_text("\n".join(lines), encoding="utf-8")
    options = photocal.JudgementOptions(standard=("decree-89817",), scale="1:1000")
    from_file, from_memory = photocal.assess(tmp_path / "d.csv", options), photocal.assess(table, options)
    assert [one.moments for one in from_file.components] == [one.moments for one in from_memory.components]


def test_the_version_is_that_of_the_package() -> None:
    from importlib.metadata import version

    assert photocal.__version__ == version("photocal")
