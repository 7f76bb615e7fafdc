"""A trajectory and exposures are equal when they are written and read again, with any names and any gaps."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from photocal.base.arrays import Floats
from photocal.base.codec import same
from photocal.base.errors import InputMalformedError, InputNotFoundError, OutputError, ProgramMissingError
from photocal.base.tables import TableColumns
from photocal.findings.finding import untested
from photocal.findings.listed import Findings
from photocal.navigation.attitude import AttitudeSeries, from_angles
from photocal.navigation.exposures import Exposures
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import InterpolatedPositions, Trajectory

# Evidence asks for 1000: PHOTOCAL_EXAMPLES=1000 pytest tests/photocal/navigation/test_written_objects.py
EXAMPLES = int(os.environ.get("PHOTOCAL_EXAMPLES", "100"))
AWKWARD = (
    "IMG 001.jpg",
    "a,b",
    'say "x"',
    "two\nlines",
    "-x",
    "é ü 日本",
    "007",
    "NaN",
    "null",
    "",
    " ",
    "[x]",
)
Draw = Callable[[st.SearchStrategy[Any]], Any]
name = st.one_of(st.sampled_from(AWKWARD), st.text(st.characters(codec="utf-8"), max_size=8))
nanoseconds = st.integers(0, 2**62)


def gappy(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Numbers of all sizes, of which some are none, infinite or a negative zero."""
    values = rng.normal(size=shape) * 10.0 ** rng.integers(-12, 12, shape)
    for odd in (np.nan, np.inf, -0.0):
        values = np.where(rng.random(shape) < 0.1, odd, values)
    return np.asarray(values)


def a_trajectory(draw: Draw, rng: np.random.Generator, count: int) -> Trajectory:
    status = np.array(
        draw(st.lists(st.sampled_from(["fixed", "float", "single"]), min_size=count, max_size=count)), "U6"
    )
    matrices, time = gappy(rng, (count, 3, 3)), draw(st.lists(nanoseconds, min_size=count, max_size=count))
    sigma = draw(st.floats(0, 10))
    lat, lon, height = gappy(rng, (3, count))
    return Trajectory(
        GpsTime(np.array(time, np.int64)),
        lat,
        lon,
        height,
        status,
        matrices,
        gappy(rng, (count, 3)),
        sigma,
    )


def some_exposures(draw: Draw, rng: np.random.Generator, count: int) -> Exposures:
    time = GpsTime(np.array(draw(st.lists(nanoseconds, min_size=count, max_size=count)), np.int64))
    gap, lat, lon, height = gappy(rng, (4, count))
    placed = InterpolatedPositions(
        rng.random(count) < 0.8,
        gap,
        lat,
        lon,
        height,
        gappy(rng, (count, 3)),
        gappy(rng, (count, 3, 3)),
        np.array(["fixed"] * count, "U6"),
    )
    attitudes = [
        AttitudeSeries(gappy(rng, (count, 3, 3)), gappy(rng, (count, 3)), gappy(rng, (count, 3, 3)))
        for _ in "12"
    ]
    images = draw(st.lists(st.lists(name, max_size=3).map(tuple), min_size=count, max_size=count))
    carrier = attitudes[1] if draw(st.booleans()) else None
    above = gappy(rng, (count,)) if draw(st.booleans()) else None
    number = rng.integers(-1, 65536, count)
    cross = gappy(rng, (count, 3, 3))
    return Exposures(time, number, placed, attitudes[0], cross, images, draw(name), carrier, above)


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data(), seed=st.integers(0, 2**32 - 1), count=st.integers(0, 5))
def test_what_is_read_again_is_equal(data: st.DataObject, seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        for make in (a_trajectory, some_exposures):
            made: TableColumns = make(data.draw, rng, count)
            path = Path(folder) / "one.parquet"
            made.write(path)
            assert same(type(made).read(path), made)
            assert made.to_arrow().num_rows == count


def small() -> Trajectory:
    unit = np.broadcast_to(np.eye(3), (2, 3, 3))
    lat, lon, height = np.array([[-22.1, -22.1], [-51.4, -51.4], [500.0, 501.0]])
    status = np.array(["fixed", "float"])
    time = GpsTime.from_week([2022, 2022], [1000.0, 1000.2])
    return Trajectory(time, lat, lon, height, status, unit, np.zeros((2, 3)), 0.1)


def test_what_a_person_sees_of_them() -> None:
    assert (
        repr(small())
        == "Trajectory from 2018-10-07 00:16:40.000 GPS, 0.2 s: 2 epochs, 1 fixed, 1 float, 0 single"
    )
    placed = InterpolatedPositions.stated(small().place, np.ones((2, 3)), ["single"] * 2)
    attitude = from_angles(np.array([[0, 0, 0], [np.nan] * 3]), None)
    shown = Exposures(
        small().time, np.arange(2), placed, attitude, np.zeros((2, 3, 3)), [("a b",), ()], "ellipsoidal"
    )
    assert repr(shown) == (
        "Exposures: 2 events, 2 with position, 1 with attitude, 1 with images; heights ellipsoidal"
    )
    table = shown.to_arrow()
    assert table["images"].to_pylist() == [["a b"], []]
    assert table["placed.covariance_m2_22"].to_pylist() == [1.0, 1.0]


def test_they_go_on_as_data_frames() -> None:
    pytest.importorskip("pandas")
    frame = small().to_pandas()
    assert frame["lat_deg"].tolist() == [-22.1, -22.1]
    assert frame["time.ns"].dtype == np.int64
    assert frame["status"].tolist() == ["fixed", "float"]
    assert list(Findings((untested("height-kind", "no-trajectory"),)).to_pandas()["severity"]) == ["untested"]


def test_bad_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputNotFoundError, match="does not exist"):
        Trajectory.read(tmp_path / "none.parquet")
    (tmp_path / "text.parquet").write_text("no table")
    with pytest.raises(InputMalformedError, match="is not a table of photocal"):
        Trajectory.read(str(tmp_path / "text.parquet"))
    pyarrow.parquet.write_table(pa.table({"lat_deg": [1.0]}), tmp_path / "foreign.parquet")
    with pytest.raises(InputMalformedError, match="is not a table of photocal"):
        Trajectory.read(tmp_path / "foreign.parquet")
    small().write(tmp_path / "whole.parquet")
    with pytest.raises(InputMalformedError, match=r"photocal\.Trajectory/1.*photocal\.Exposures/1"):
        Exposures.read(tmp_path / "whole.parquet")
    cut = pyarrow.parquet.read_table(tmp_path / "whole.parquet").drop(["height_m"])
    pyarrow.parquet.write_table(cut, tmp_path / "cut.parquet")
    with pytest.raises(InputMalformedError, match="height_m"):
        Trajectory.read(tmp_path / "cut.parquet")
    with pytest.raises(OutputError):
        small().write(tmp_path)


@pytest.mark.parametrize(("package", "way"), [("pandas", "to_pandas"), ("pyarrow", "to_arrow")])
def test_a_package_that_is_missing_is_named(package: str, way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ProgramMissingError, match=f"pip install {package}"):
        getattr(small(), way)()
