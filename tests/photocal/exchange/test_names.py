"""Names of images of several folders: none comes twice, and those that come once stay."""

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from photocal.exchange.parts import distinct

NAMES = st.lists(st.sampled_from(["a", "a (2)", "a (3)", "b", "{}", "{0}"]), max_size=12)


@given(names=NAMES)
def test_no_name_comes_twice_and_single_ones_stay(names: list[str]) -> None:
    made = distinct(names)
    assert len(set(made)) == len(names)
    assert all(own.startswith(name) for own, name in zip(made, names, strict=True))
    count = Counter(names)
    assert [own for own, name in zip(made, names, strict=True) if count[name] == 1] == [
        name for name in names if count[name] == 1
    ]


def test_a_number_that_is_taken_is_left_out() -> None:
    assert distinct(["a", "a", "a (2)"]) == ["a", "a (3)", "a (2)"]
    assert distinct(["a", "a", "a"]) == ["a", "a (2)", "a (3)"]
