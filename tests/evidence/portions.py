"""Long studies in portions: what a tally does not have yet is run until the time is up, and added to it.

Every study that uses it takes `--tally FILE` (without it all cases are run at once), `--minutes M` after
which no case is begun, and `--from K --count N` for some of its cases only. Its page is written from all of
the tally, and says how many cases that are.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import islice
from pathlib import Path
from typing import Any

# Names and numbers that say what is run, as they stand in JSON.
Case = tuple[Any, ...]
WORKERS = 2


def outcomes(cases: Iterator[Case], count: int, run: Callable[..., Any]) -> dict[Case, Any]:
    """Run some of the cases, the first `count` of them unless the command line says which.

    What `run` gives of a case must be what JSON can hold. The result has the cases of earlier portions, too,
    in the order of their names.
    """
    asked = argparse.ArgumentParser()
    asked.add_argument("--tally", type=Path)
    asked.add_argument("--minutes", type=float, default=float("inf"))
    asked.add_argument("--from", type=int, default=0, dest="first")
    asked.add_argument("--count", type=int, default=count)
    asked.add_argument("--workers", type=int, default=WORKERS)
    given = asked.parse_args()
    has_tally = given.tally is not None and given.tally.is_file()
    tally = {tuple(case): found for case, found in json.loads(given.tally.read_text())} if has_tally else {}
    chosen = [one for one in islice(cases, given.first, given.first + given.count) if one not in tally]
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    until, waiting = time.monotonic() + 60.0 * given.minutes, iter(chosen)
    running = dict[Future[Any], Case]()
    with ProcessPoolExecutor(given.workers) as pool:
        while True:
            while len(running) < given.workers and time.monotonic() < until and (case := next(waiting, None)):
                running[pool.submit(run, *case)] = case
            if not running:
                break
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                case = running.pop(done)
                tally[case] = done.result()
                sys.stderr.write(f"{len(tally)}: {case}\n")
            if given.tally is not None:
                given.tally.write_text(json.dumps(list(tally.items())))
    return dict(sorted(tally.items(), key=lambda item: json.dumps(item[0])))
