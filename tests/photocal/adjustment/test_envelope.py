"""Band and border matrices against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from photocal.adjustment.envelope import dense, envelope, factorise, selected_inverse, solve
from photocal.adjustment.kernels.data import Structure

Floats = NDArray[np.float64]


def positions(structure: Structure) -> NDArray[np.bool_]:
    """Elements that the structure keeps, below the diagonal and on it."""
    return np.asarray(np.tril(dense(structure, np.ones(int(structure.offset[-1]))) != 0))


@st.composite
def systems(draw: st.DrawFn) -> tuple[Structure, Floats, Floats]:
    """A structure, its values and the same matrix in full; positive definite."""
    block = draw(st.sampled_from([1, 3, 6]))
    count = draw(st.integers(0, 30))
    border = draw(st.integers(0 if count else 1, 15))
    steps = draw(st.lists(st.integers(1, max(count, 1)), min_size=count, max_size=count))
    reach = block * np.minimum(np.arange(count) + np.array(steps, dtype=np.int64), count)
    structure = envelope(reach.astype(np.int64), block, border)
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    size = structure.size
    full = np.zeros((size, size))
    for k, end in enumerate(reach):
        columns = slice(block * k, block * (k + 1))
        full[block * k : end, columns] = rng.normal(size=(end - block * k, block))
    full[count * block :] = rng.normal(size=(border, size))
    full = np.tril(full)
    full = full + np.tril(full, -1).T
    full += np.diag(np.abs(full).sum(axis=1) + 0.1)
    return structure, packed(structure, full), full


def packed(structure: Structure, full: Floats) -> Floats:
    """Values of a full matrix, column by column from their definition."""
    values = structure.zeros()
    last = [*structure.last.tolist(), structure.size]
    for j, panel in enumerate(structure.panels(values)):
        band = j < len(structure.last)
        top = j * structure.panel if band else structure.band
        rows = np.r_[top : last[j], structure.band : structure.size] if band else np.arange(top, last[j])
        for k in range(int(structure.width[j])):
            panel[:, k] = np.where(rows >= top + k, full[rows, top + k], 0.0)
    return values


@settings(max_examples=25)
@given(systems())
def test_packing_and_solution(system: tuple[Structure, Floats, Floats]) -> None:
    structure, values, full = system
    assert dense(structure, values) == pytest.approx(full, abs=0)
    assert factorise(structure, values) == -1
    right = np.random.default_rng(1).normal(size=(structure.size, 3))
    expected = np.linalg.solve(full, right)
    assert solve(structure, values, right) == pytest.approx(expected, rel=1e-9, abs=1e-11)
    assert solve(structure, values, right[:, 0]) == pytest.approx(expected[:, 0], rel=1e-9, abs=1e-11)


@settings(max_examples=25)
@given(systems())
def test_selected_inverse(system: tuple[Structure, Floats, Floats]) -> None:
    structure, values, full = system
    assert factorise(structure, values) == -1
    inverse = dense(structure, selected_inverse(structure, values))
    kept = positions(structure)
    assert inverse[kept] == pytest.approx(np.linalg.inv(full)[kept], rel=1e-9, abs=1e-12)


@settings(max_examples=25)
@given(systems(), st.data())
def test_an_indefinite_matrix_is_noticed(
    system: tuple[Structure, Floats, Floats], data: st.DataObject
) -> None:
    structure, _, full = system
    bad = data.draw(st.integers(0, structure.size - 1))
    full[bad, bad] = -1.0
    assert factorise(structure, packed(structure, full)) == bad


@pytest.mark.parametrize("count", [1, 23, 24, 25, 48, 100])
def test_panels_around_their_size(count: int) -> None:
    # 24 blocks of 6 columns make a panel.
    reach = 6 * np.minimum(np.arange(count) + 4, count)
    structure = envelope(reach.astype(np.int64), 6, 2)
    size = structure.size
    rng = np.random.default_rng(count)
    root = np.zeros((size, size))
    for k, end in enumerate(reach):
        root[6 * k : end, 6 * k : 6 * k + 6] = rng.normal(size=(end - 6 * k, 6))
    root[6 * count :] = rng.normal(size=(2, size))
    root = np.tril(root, -1) + 5 * np.eye(size)
    values = packed(structure, root @ root.T)
    assert factorise(structure, values) == -1
    assert dense(structure, values)[positions(structure)] == pytest.approx(
        root[positions(structure)], abs=1e-9
    )
