"""Trigger count against feedback count: which pictures were asked for and never reported."""

from dataclasses import dataclass, replace

# So long after a trigger its feedback may come: shutters need tenths of a second. What a slow radio brings
# later is taken back from the missed ones.
GRACE_NS = 700_000_000


@dataclass(frozen=True)
class Trigger:
    """A picture that was asked for: number, moment (UTC ns), latitude and longitude (deg; None: unknown)."""

    number: int
    time_ns: int
    place: tuple[float, float] | None = None


@dataclass(frozen=True)
class CountedPictures:
    """The pictures of one link, counted.

    A picture that was asked for by trigger message, or whose number the feedback has skipped, counts as
    missed as long as its own feedback has not come.

    triggers, feedbacks: how many pictures were asked for, and how many were reported.
    pending, missed: those that may still be reported, and those that were not.
    before: those that were not before the device last started again: their numbers have come to mean others.
    offset: number of a feedback less that of its trigger: devices begin to count at 0 or 1.
    """

    triggers: int = 0
    feedbacks: int = 0
    pending: tuple[Trigger, ...] = ()
    missed: tuple[Trigger, ...] = ()
    before: tuple[Trigger, ...] = ()
    last_trigger: int | None = None
    last_feedback: int | None = None
    offset: int | None = None

    @property
    def unreported(self) -> tuple[Trigger, ...]:
        """All that were missed."""
        return self.before + self.missed


def triggered(counted: CountedPictures, trigger: Trigger) -> CountedPictures:
    """Take note of a trigger; one that is told again counts once."""
    # What waits for an answer is kept up to this number.
    most_pending = 1000
    last = counted.last_trigger
    if last == trigger.number:
        return counted
    if last is not None and trigger.number < last:
        # The device has started again: what was open stays open for good.
        counted = _restarted(counted)
    return replace(
        counted,
        triggers=counted.triggers + 1,
        pending=(*counted.pending, trigger)[-most_pending:],
        last_trigger=trigger.number,
    )


def reported(
    counted: CountedPictures, number: int, time_ns: int, place: tuple[float, float] | None = None
) -> CountedPictures:
    """Take note of a feedback: closes its trigger, and shows which numbers were skipped before it."""
    last = counted.last_feedback
    if last == number:
        return counted
    if counted.offset is None:
        announced = not counted.pending or any(trigger.number == number for trigger in counted.pending)
        counted = replace(counted, offset=0 if announced else number - counted.pending[-1].number)
    offset = counted.offset or 0
    wanted = number - offset
    open_ = {trigger.number for trigger in counted.missed}
    if wanted in open_:
        # It only came late.
        missed = tuple(trigger for trigger in counted.missed if trigger.number != wanted)
        return replace(counted, feedbacks=counted.feedbacks + 1, missed=missed)
    if last is not None and number < last:
        # The offset is found anew: the device may have begun at another number.
        return reported(_restarted(counted), number, time_ns, place)
    pending_numbers = {trigger.number for trigger in counted.pending}
    # A longer jump of the numbers is another way of counting, not so many lost pictures.
    longest_gap = 1000
    first = number if last is None or number - last > longest_gap else last + 1
    skipped = [
        Trigger(skip, time_ns, place)
        for skip in range(first - offset, wanted)
        if skip not in pending_numbers and skip not in open_
    ]
    passed = [trigger for trigger in counted.pending if trigger.number < wanted]
    return replace(
        counted,
        # A picture whose trigger was not told was asked for all the same.
        triggers=counted.triggers + len(skipped) + (wanted not in pending_numbers),
        feedbacks=counted.feedbacks + 1,
        pending=tuple(trigger for trigger in counted.pending if trigger.number > wanted),
        missed=(*counted.missed, *sorted([*passed, *skipped], key=lambda trigger: trigger.number)),
        last_feedback=number,
    )


def settled(counted: CountedPictures, now_ns: int) -> CountedPictures:
    """Count as missed what has waited for too long; without any feedback so far nothing is expected."""
    if not counted.feedbacks or not counted.pending or now_ns - counted.pending[0].time_ns <= GRACE_NS:
        return counted
    late = tuple(t for t in counted.pending if now_ns - t.time_ns > GRACE_NS)
    return replace(counted, pending=counted.pending[len(late) :], missed=(*counted.missed, *late))


def numbers(missed: tuple[Trigger, ...]) -> str:
    """Return numbers in words: ``"7, 12-15"``."""
    parts: list[list[int]] = []
    for trigger in missed:
        if parts and trigger.number == parts[-1][1] + 1:
            parts[-1][1] = trigger.number
        else:
            parts.append([trigger.number, trigger.number])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in parts)


def _restarted(counted: CountedPictures) -> CountedPictures:
    still_open = counted.pending if counted.feedbacks else ()
    before = (*counted.before, *counted.missed, *still_open)
    return CountedPictures(counted.triggers, counted.feedbacks, before=before)
