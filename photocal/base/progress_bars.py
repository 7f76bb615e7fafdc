"""How far work is, on standard error: a bar at a terminal, lines into a file or for a program."""

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from types import MappingProxyType

from photocal.base.console import printable
from photocal.base.progress import Bar, Standing, followed

# Into a file, or to a program that reads along, a line of progress is written so often.
LINE_EVERY_S = 10.0
# What such a line says behind the title.
_LEFT = "{share}%, {seconds} s left"
# The same of a whole run, in a line and beside a bar.
OF_RUN, ON_BAR = "{share}% of the run, {seconds} s left", "{clock} left"
# What a run does before it knows its stages.
STARTING = "starting"


class _Lines:
    """A line now and then: what is done of a piece of work, and the time left."""

    def __init__(self, title: str, total: float | None, left: str) -> None:
        self._title, self._total, self._left, self._done = title, total, left, 0.0
        self._began = self._shown_s = time.monotonic()

    def advance(self, amount: float) -> None:
        """Count what was done since the last call."""
        self._done += amount
        now = time.monotonic()
        if now - self._shown_s < LINE_EVERY_S:
            return
        self._shown_s, elapsed = now, now - self._began
        line = f"{self._title}: {elapsed:.0f} s"
        # Unfinished work shows neither 100 % nor 0 s left. Before the first per cent the time left is
        # unknown: kernels may be compiled.
        if self._total and (share := math.floor(100 * self._done / self._total)):
            seconds = math.ceil(max(elapsed * (self._total / self._done - 1), 0))
            line = f"{self._title}: {self._left.format(share=share, seconds=seconds)}"
        print(line, file=sys.stderr, flush=True)


@contextmanager
def progress(title: str, total: float | None, left: str = _LEFT) -> Iterator[Callable[[float], None]]:
    """Show on standard error how far a longer piece of work is: a bar, or a line now and then into a file.

    total: the amount of work, in any unit; None when it is not known.
    left: how a line says the share that is done, %, and the seconds left.
    """
    if not sys.stderr.isatty():
        # The import of the bar would cost more than many a piece of work.
        yield _Lines(title, total, left).advance
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(title, total=total)
        yield lambda amount: bar.advance(task, amount)


def one_bar(as_json: bool = False, words: Mapping[str, str] = MappingProxyType({})) -> Bar:
    """Show a run of several stages on standard error by one bar, or line by line into a file or as JSON.

    words: titles of work, `OF_RUN` and `ON_BAR` in the language of the person, where that is not English.
    """
    # To a program that asked for JSON.
    json_every_s = 1.0
    if as_json:
        return partial(_as_lines, json_every_s, _as_json)
    if sys.stderr.isatty():
        return partial(_on_terminal, words)
    return partial(_as_lines, LINE_EVERY_S, partial(_in_words, words))


@contextmanager
def while_starting(bar: Bar) -> Iterator[None]:
    """Show a run that has begun before it knows its stages: modules take seconds to load from a slow disk."""
    began = time.monotonic()
    # What starts at once, or is refused at once, says nothing of it.
    quick_s = 0.5

    def standing() -> Standing:
        """Tell for how long it has been starting."""
        elapsed = time.monotonic() - began
        return Standing("", STARTING, None, None, elapsed, 0.0, math.nan, elapsed)

    with bar() as show:

        def tell(now: Standing) -> None:
            """Show it once it takes long."""
            if now.elapsed_s > quick_s:
                show(now)

        with followed(standing, tell):
            yield


@contextmanager
def _on_terminal(words: Mapping[str, str]) -> Iterator[Callable[[Standing], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as RichProgress

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
    )
    # An answer that comes before the end stands above the bar, but goes where a person has sent it.
    console, above = Console(stderr=True), sys.stdout.isatty()
    with RichProgress(*columns, console=console, transient=True, redirect_stdout=above) as bar:
        task = bar.add_task("", total=1.0, left="")

        def show(now: Standing) -> None:
            """Draw it anew."""
            known = math.isfinite(now.left_s)
            left = words.get(ON_BAR, ON_BAR).format(clock=clock(now.left_s)) if known else ""
            bar.update(task, description=_doing(now, words), completed=now.share, left=left)

        yield show


@contextmanager
def _as_lines(every_s: float, line: Callable[[Standing], str]) -> Iterator[Callable[[Standing], None]]:
    last = -math.inf

    def show(now: Standing) -> None:
        """Write a line now and then."""
        nonlocal last
        if now.elapsed_s - last >= every_s - 0.5:
            last = now.elapsed_s
            if said := line(now):
                print(said, file=sys.stderr, flush=True)

    yield show


def _in_words(words: Mapping[str, str], now: Standing) -> str:
    # Whoever reads a file learns nothing from a run that is starting.
    if not math.isfinite(now.left_s):
        return ""
    doing = _doing(now, words)
    left = words.get(OF_RUN, OF_RUN).format(share=math.floor(100 * now.share), seconds=math.ceil(now.left_s))
    return f"{doing}: {left}" if doing else left


def _as_json(now: Standing) -> str:
    kept = {"stage": now.stage, "title": now.title, "share": round(now.share, 4)}
    left_s = round(now.left_s, 1) if math.isfinite(now.left_s) else None
    seconds = {"left_s": left_s, "elapsed_s": round(now.elapsed_s, 1)}
    return json.dumps({"progress": kept | seconds})


def _doing(now: Standing, words: Mapping[str, str]) -> str:
    # A stage of one piece of work has its name, by which `--again` and `--until` know it.
    title = "" if now.title == now.stage else words.get(now.title, now.title)
    return printable(": ".join(filter(None, (now.stage, title))))


def clock(seconds: float) -> str:
    """Write seconds as hours, minutes and seconds."""
    minutes, rest = divmod(math.ceil(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"
