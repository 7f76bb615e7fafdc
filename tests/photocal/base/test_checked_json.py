"""JSON that two programs could read in two ways is refused."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from photocal.base.checked_toml import read_checked_json


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ('{"number": "PC-FORGED", "number": "PC-1"}', "key 'number' twice"),
        ('{"a": [{"b": 1, "b": 1}]}', "key 'b' twice"),
        ('{"a": 1, "\\u0061": 2}', "key 'a' twice"),
        ("[NaN]", "NaN"),
        ("[-Infinity]", "-Infinity"),
        ("[1e999]", "1e999"),
    ],
)
def test_it_is_refused_with_its_cause(text: str, cause: str) -> None:
    with pytest.raises(ValueError, match=cause):
        read_checked_json(text)


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(),
        lambda part: st.lists(part) | st.dictionaries(st.text(), part),
    )
)
def test_all_else_is_read_as_by_the_standard_library(content: object) -> None:
    text = json.dumps(content)
    assert read_checked_json(text) == json.loads(text) == content
