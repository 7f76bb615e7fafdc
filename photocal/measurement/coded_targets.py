"""Coded targets on the ground, AprilTag or ArUco plates: found in whole images, named by control points."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from photocal.exchange.parts import Mark
from photocal.measurement.cache import Arrays, cached, combined_key
from photocal.measurement.image_file import read_grey
from photocal.measurement.markers import dictionary, find_markers
from photocal.measurement.refine import Source
from photocal.tasks.workers import Workers, run_tasks

# Raised whenever the meaning of cached results changes.
VERSION = 3
# Plates are not flat and lenses not modelled to the last: what the grey values cannot know, px.
COMMON_PX = 0.02


@dataclass(frozen=True)
class _Task:
    source: Source
    dictionary: str


def find_coded_targets(
    sources: Sequence[Source],
    dictionary_name: str,
    names: Mapping[str, str],
    processes: Workers,
    done: Callable[[float], None],
) -> tuple[tuple[Mark, ...], tuple[str, ...]]:
    """Find coded targets in images."""
    dictionary(dictionary_name)
    marks, strangers = [], []
    tasks = (_Task(source, dictionary_name) for source in sources)
    for source, found in zip(sources, run_tasks(_find, tasks, processes), strict=True):
        for code, x, y, sx, sy in found.tolist():
            name = names.get(str(int(code)))
            if name is None:
                strangers.append(f"code {int(code)} in {source.path.name}")
            else:
                sigma = (math.hypot(sx, COMMON_PX), math.hypot(sy, COMMON_PX))
                marks.append(Mark(source.path.name, name, x, y, sigma, f"code {int(code)}"))
        done(1)
    return tuple(marks), tuple(strangers)


def _find(task: _Task) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    def make() -> Arrays:
        found = find_markers(read_grey(task.source.path), task.dictionary)
        rows = [(m.identity, m.centre.column, m.centre.row, *m.centre.sigma) for m in found]
        return {"targets": np.array(rows, dtype=float).reshape(-1, 5)}

    key = combined_key(VERSION, "coded targets", task.source.key, task.dictionary)
    return np.asarray(cached(task.source.cache, key, ("targets",), make)["targets"], dtype=np.float64)
