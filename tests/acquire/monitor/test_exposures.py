"""Trigger count against feedback count, judged by hand and by a plain bookkeeper of sets."""

from __future__ import annotations

from functools import reduce

from hypothesis import given, settings
from hypothesis import strategies as st

from acquire.monitor.state import (
    GRACE_NS,
    CountedPictures,
    Trigger,
    numbers,
    reported,
    settled,
    triggered,
)

SECOND = 1_000_000_000


def after(*events: tuple[str, int, float]) -> CountedPictures:
    """Return the count after events: what, number, second."""

    def step(counted: CountedPictures, event: tuple[str, int, float]) -> CountedPictures:
        what, number, second = event
        time_ns = round(second * SECOND)
        if what == "trigger":
            return triggered(counted, Trigger(number, time_ns))
        if what == "feedback":
            return reported(counted, number, time_ns)
        return settled(counted, time_ns)

    return reduce(step, events, CountedPictures())


def missed(counted: CountedPictures) -> list[int]:
    return [trigger.number for trigger in counted.unreported]


def test_each_picture_that_is_reported_is_well() -> None:
    events = [(what, n, 2.0 * n + d) for n in range(1, 9) for what, d in (("trigger", 0), ("feedback", 0.3))]
    counted = after(*events, ("now", 0, 100))
    assert (counted.triggers, counted.feedbacks, missed(counted)) == (8, 8, [])


def test_a_picture_without_feedback_is_missed_after_a_while_and_not_before() -> None:
    events = [("trigger", 1, 0), ("feedback", 1, 0.2), ("trigger", 2, 2)]
    assert missed(after(*events, ("now", 0, 2 + GRACE_NS / SECOND))) == []
    assert missed(after(*events, ("now", 0, 2.001 + GRACE_NS / SECOND))) == [2]


def test_the_next_feedback_shows_the_loss_at_once() -> None:
    counted = after(
        ("trigger", 1, 0), ("feedback", 1, 0), ("trigger", 2, 0.5), ("trigger", 3, 0.9), ("feedback", 3, 1)
    )
    assert (counted.triggers, counted.feedbacks, missed(counted)) == (3, 2, [2])


def test_feedback_alone_tells_by_its_numbers() -> None:
    """ArduPilot numbers its feedback by the triggers and sends no message of the trigger itself."""
    counted = after(("feedback", 5, 0), ("feedback", 6, 1), ("feedback", 9, 4))
    assert (counted.triggers, counted.feedbacks, missed(counted)) == (5, 3, [7, 8])


def test_what_comes_late_is_not_missed_any_more() -> None:
    events = [("trigger", 1, 0), ("feedback", 1, 0), ("trigger", 2, 2), ("now", 0, 5), ("feedback", 2, 6)]
    counted = after(*events)
    assert (counted.triggers, counted.feedbacks, missed(counted)) == (2, 2, [])


def test_what_is_told_twice_counts_once() -> None:
    counted = after(*[(w, n, n) for n in (1, 2) for w in ("trigger", "trigger", "feedback", "feedback")])
    assert (counted.triggers, counted.feedbacks, missed(counted)) == (2, 2, [])


def test_triggers_may_begin_at_nought_and_feedback_at_one() -> None:
    events = [
        (w, n + (w == "feedback"), n + d) for n in range(4) for w, d in (("trigger", 0), ("feedback", 0.1))
    ]
    counted = after(*events, ("trigger", 4, 4), ("now", 0, 9))
    assert missed(counted) == [4]


def test_a_device_that_starts_again_counts_on() -> None:
    first = [(w, n, n) for n in (1, 2, 3) for w in ("trigger", "feedback")]
    again = [(w, n, 20 + n) for n in (1, 2) for w in ("trigger", "feedback")]
    counted = after(*first, ("trigger", 4, 4), *again, ("now", 0, 60))
    assert (counted.triggers, counted.feedbacks, missed(counted)) == (6, 5, [4])


def test_without_any_feedback_nothing_is_expected() -> None:
    assert missed(after(*[("trigger", n, n) for n in range(50)], ("now", 0, 100))) == []


@settings(max_examples=300)
@given(
    st.lists(st.tuples(st.booleans(), st.booleans(), st.floats(0.0, 0.9)), min_size=1, max_size=40),
    st.booleans(),
)
def test_a_bookkeeper_finds_the_same(pictures: list[tuple[bool, bool, float]], triggers_told: bool) -> None:
    """Pictures two seconds apart; each says whether its trigger was heard, whether its feedback, how late."""
    events = [("trigger", 1, 2.0), ("feedback", 1, 2.1)]
    asked, seen = {1}, {1}
    for place, (heard, told, delay) in enumerate(pictures):
        number, second = place + 2, 4.0 + 2 * place
        if heard and triggers_told:
            events.append(("trigger", number, second))
            asked.add(number)
        if told:
            events.append(("feedback", number, second + delay))
            seen.add(number)
    # What no message names is known as soon as a later feedback shows that it was.
    asked |= set(range(1, max(seen) + 1))
    counted = after(*events, ("now", 0, 1000))
    assert missed(counted) == sorted(asked - seen)
    assert (counted.triggers, counted.feedbacks) == (len(asked), len(seen))


def test_numbers_in_words() -> None:
    assert numbers(tuple(Trigger(n, 0) for n in (3, 7, 8, 9, 12, 13))) == "3, 7-9, 12-13"
    assert numbers(()) == ""
