"""Objects from plain values: annotations that are aliases with parameters."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
import pytest
from typing_extensions import TypeAliasType

from photocal.base.codec import from_plain

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
