"""Objects from plain values, and from the arrays that they were packed into."""

from __future__ import annotations

import gc
import weakref
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from photocal.base.codec import from_plain, packed, same, unpacked
from photocal.block.folder import read_block
from photocal.block.model import Block
from tests.evidence.judging import fly
from tests.independent.flights import Design, Errors

Scalar = TypeVar("Scalar", bound=np.generic)
# As numpy defines NDArray from 2.5 on.
Array = TypeAliasType("Array", np.ndarray[tuple[Any, ...], np.dtype[Scalar]], type_params=(Scalar,))


def test_an_array_is_read_by_the_alias_of_its_type() -> None:
    read = from_plain(Array[np.float64], [3.79, 2.42])
    assert read.dtype == np.float64
    assert read.tolist() == [3.79, 2.42]
    assert from_plain(Array[np.int64], [[1, 2]]).dtype == np.int64


def test_what_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="could not convert"):
        from_plain(Array[np.float64], ["a"], "place")


def test_an_object_that_was_packed_is_the_same_again(tmp_path: Path) -> None:
    design = Design("small", images=4, per_image=20)
    fly(tmp_path / "block", design, Errors(), 0)
    block = read_block(tmp_path / "block")
    arrays: Any = packed(block)
    np.savez(tmp_path / "kept.npz", **arrays)
    with np.load(tmp_path / "kept.npz", allow_pickle=False) as held:
        again = unpacked(Block, held)
    # Some of its standard deviations are infinite, some of its values are unknown.
    assert np.isinf(block.images.sigma).any()
    assert same(again, block)


def test_nothing_is_left_of_what_was_packed_and_unpacked() -> None:
    """Of millions of rays it would be hundreds of megabytes, until garbage is next searched for."""
    gc.disable()
    try:
        taken = np.zeros(3)
        arrays = packed({"part": taken})
        made = unpacked(dict[str, NDArray[Any]], arrays)
        left = [weakref.ref(taken), weakref.ref(made["part"]), weakref.ref(next(iter(arrays.values())))]
        del taken, arrays, made
        assert all(ref() is None for ref in left)
    finally:
        gc.enable()
