"""A block folder means the same however it is written; a damaged one is refused."""

from __future__ import annotations

import csv
import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError, PhotocalError
from photocal.block.folder import read_block
from photocal.block.model import Block
from tests.photocal.blocks import SMALL_TOML, adjusted_json, small, table


def same(one: Block, other: Block) -> bool:
    """Whether two blocks hold the same data."""
    return (
        one.images.names == other.images.names
        and one.points.names == other.points.names
        and all(
            np.array_equal(
                getattr(getattr(one, part), name), getattr(getattr(other, part), name), equal_nan=True
            )
            for part, names in (
                ("images", ("camera", "values", "sigma")),
                ("points", ("values", "sigma", "role")),
                ("observations", ("image", "point", "values", "sigma")),
            )
            for name in names
        )
    )


@pytest.fixture
def block(tmp_path: Path) -> Path:
    return small(tmp_path / "block")


def test_values_units_and_empty_cells(block: Path) -> None:
    read = read_block(block)
    assert read.images.names == ("a", "b", "c")
    assert read.images.values[0] == pytest.approx(
        [*np.radians([-6.231, 24.226, 2.565]), 4.557, 1.167, 9.481], abs=1e-15
    )
    assert np.isinf(read.images.sigma).all()
    assert read.points.sigma[0].tolist() == [0.003] * 3
    assert np.isinf(read.points.sigma[5:]).all()
    assert read.points.role.tolist() == [0] * 5 + [1, 2]
    assert (read.observations.sigma == 0.003).all()
    assert [f.path for f in read.inputs] == ["block.toml", "images.csv", "points.csv", "observations.csv"]


def test_fingerprints_are_those_of_the_files(block: Path) -> None:
    for file in read_block(block).inputs:
        content = (block / file.path).read_bytes()
        assert (file.sha256, file.bytes) == (hashlib.sha256(content).hexdigest(), len(content))


@pytest.mark.parametrize(
    "rewrite",
    [
        lambda content: content.replace(b"\n", b"\r\n"),
        lambda content: b"\xef\xbb\xbf" + content,
        lambda content: content + b"\n\n",
        lambda content: content.replace(b",", b" , "),
        lambda content: content.replace(b",0.0", b",+0.0").replace(b",-0.0", b",-00.0"),
    ],
    ids=["CRLF", "BOM", "empty lines", "blanks", "signs"],
)
@pytest.mark.parametrize("name", ["images.csv", "points.csv", "observations.csv"])
def test_other_spellings_of_the_same_table(block: Path, name: str, rewrite: Callable[[bytes], bytes]) -> None:
    before = read_block(block)
    content = (block / name).read_bytes()
    (block / name).write_bytes(rewrite(content))
    assert same(read_block(block), before)


def test_columns_in_any_order(block: Path) -> None:
    before = read_block(block)
    for name in ("images.csv", "points.csv", "observations.csv"):
        columns = pyarrow.csv.read_csv(block / name)
        pyarrow.csv.write_csv(columns.select(columns.column_names[::-1]), block / name)
    assert same(read_block(block), before)


@pytest.mark.parametrize("name", ["images.csv", "points.csv", "observations.csv"])
def test_a_table_cut_at_any_byte(block: Path, name: str) -> None:
    """Refused in one line, or read as exactly the rows that are whole.

    A cut at the end of a row leaves a shorter table, which nothing in the file gives away; a number that has
    lost digits must never be taken for the number. (A single row without line end has no other row to compare
    its last number with: such cuts are not looked at.)
    """
    whole = read_block(block)
    content = (block / name).read_bytes()
    part = name.removesuffix(".csv")
    for length in range(len(content)):
        if content[:length].count(b"\n") == 1:
            continue
        (block / name).write_bytes(content[:length])
        try:
            read = read_block(block)
        except (InputMalformedError, InputNotFoundError) as refusal:
            assert "\n" not in str(refusal)  # noqa: PT017
            continue
        values = getattr(read, part).values
        assert len(values) == content[: length + 1].count(b"\n") - 1, (length, content[:length][-30:])
        assert np.array_equal(values, getattr(whole, part).values[: len(values)], equal_nan=True)


def test_a_setup_cut_at_any_byte(block: Path) -> None:
    whole = read_block(block)
    content = SMALL_TOML.encode()
    for length in range(len(content) - 1):
        (block / "block.toml").write_bytes(content[:length])
        try:
            read = read_block(block)
        except PhotocalError as refusal:
            assert isinstance(refusal, ConfigurationError | InputNotFoundError)  # noqa: PT017
            continue
        # Only the list of what is estimated stands at the end: without it nothing is.
        assert same(read, whole)
        assert not read.cameras[0].estimated.any()


def test_parquet_observations_equal_csv(block: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(block, other)
    with (block / "observations.csv").open(newline="") as text:
        rows = list(csv.DictReader(text))
    (other / "observations.csv").unlink()
    columns: dict[str, Any] = {name: [r[name] for r in rows] for name in ("image", "point")}
    columns |= {name: [float(r[name]) for r in rows] for name in ("x", "y")}
    pyarrow.parquet.write_table(pa.table(columns), other / "observations.parquet")
    assert same(read_block(block), read_block(other))
    one, two = adjusted_json(block, tmp_path / "run1"), adjusted_json(other, tmp_path / "run2")
    assert one["cameras"] == two["cameras"]
    assert (tmp_path / "run1" / "residuals.csv").read_bytes() == (
        tmp_path / "run2" / "residuals.csv"
    ).read_bytes()


def test_parquet_with_numbered_and_categorical_names(block: Path) -> None:
    """Other programs write names as integers or as dictionaries."""
    for name, column in (("images.csv", "image"), ("points.csv", "point")):
        text = (block / name).read_text()
        for k, old in enumerate("abc" if column == "image" else [f"p{j}" for j in range(7)]):
            text = text.replace(f"\n{old},", f"\n{k},")
        (block / name).write_text(text)
    rows = [line.split(",") for line in (block / "observations.csv").read_text().split()[1:]]
    (block / "observations.csv").unlink()
    columns = {
        "image": pa.array(["abc".index(r[0]) for r in rows]),
        "point": pa.array([r[1][1:] for r in rows]).dictionary_encode(),
        "x": pa.array([float(r[2]) for r in rows]),
        "y": pa.array([float(r[3]) for r in rows], pa.float32()),
    }
    pyarrow.parquet.write_table(pa.table(columns), block / "observations.parquet")
    read = read_block(block)
    assert read.images.names == ("0", "1", "2")
    assert read.observations.image.tolist() == ["abc".index(r[0]) for r in rows]
    assert read.observations.point.tolist() == [int(r[1][1:]) for r in rows]


def test_missing_cells_in_parquet(block: Path) -> None:
    (block / "observations.csv").unlink()
    columns = {"image": ["a", "b"], "point": ["p0", "p0"], "x": [1.0, None], "y": [1.0, 2.0]}
    pyarrow.parquet.write_table(pa.table(columns), block / "observations.parquet")
    with pytest.raises(InputMalformedError, match=r"row 2: x is empty"):
        read_block(block)
    columns = {"image": ["a", None], "point": ["p0", "p0"], "x": [1.0, 2.0], "y": [1.0, 2.0]}
    pyarrow.parquet.write_table(pa.table(columns), block / "observations.parquet")
    with pytest.raises(InputMalformedError, match=r"row 2: image is empty"):
        read_block(block)


def test_single_sigmas_of_observations(block: Path) -> None:
    """A sigma of its own wins; an empty cell takes the common one."""
    lines = (block / "observations.csv").read_text().split()
    rows = [
        [*line.split(","), "0.01" if k == 0 else "", "0.02" if k < 2 else ""]
        for k, line in enumerate(lines[1:])
    ]
    table(block / "observations.csv", lines[0] + ",sx,sy", rows)
    sigma = read_block(block).observations.sigma
    assert sigma[:3].tolist() == [[0.01, 0.02], [0.003, 0.02], [0.003, 0.003]]


def test_sigmas_of_exposures(block: Path) -> None:
    lines = (block / "images.csv").read_text().split()
    table(
        block / "images.csv",
        lines[0] + ",sX,sY,sZ,so,sp,sk",
        [[lines[1], "0", "0.1", "", "", "0.5", "0"], [lines[2], *[""] * 6], [lines[3], *[""] * 6]],
    )
    sigma = read_block(block).images.sigma
    assert sigma[0] == pytest.approx([np.inf, np.radians(0.5), 0.0, 0.0, 0.1, np.inf])
    assert np.isinf(sigma[1:]).all()
