"""The nearest descriptors of each feature among those in its window, compiled."""

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Integers
from photocal.base.compiled import allocating

Floats32 = NDArray[np.float32]


@allocating
def nearest(
    first: Floats32,
    second: Floats32,
    begins: Integers,
    spans: Integers,
    forward: Integers,
    likeness: Floats32,
    backward: Floats32,
) -> None:
    """Find for each descriptor of the first image the most alike ones of its window.

    first (n, d), second (m, d): of unit length.
    begins (windows + 1,): where the rows of each window begin in `first`.
    spans (windows, k, 2): first and last but one of the rows of `second` that belong to a window.
    forward (n,): gets the most alike row of `second`.
    likeness (n, 2): starts at -1 and gets the largest likeness and the next one.
    backward (m,): starts at -1 and gets the largest likeness of each row of `second`.
    """
    for window in range(len(spans)):
        start, end = begins[window], begins[window + 1]
        for span in range(spans.shape[1]):
            low, high = spans[window, span, 0], spans[window, span, 1]
            if high <= low:
                continue
            alike = np.dot(first[start:end], second[low:high].T)
            for i in range(end - start):
                row = start + i
                best, next_best, where = likeness[row, 0], likeness[row, 1], forward[row]
                for j in range(high - low):
                    value = alike[i, j]
                    if value > backward[low + j]:
                        backward[low + j] = value
                    if value > next_best:
                        if value > best:
                            best, next_best, where = value, best, low + j
                        else:
                            next_best = value
                likeness[row, 0], likeness[row, 1], forward[row] = best, next_best, where


def compile_kernels() -> None:
    """Compare two descriptors at setup: no measurement waits for the compiler."""
    two, both = np.eye(2, dtype=np.float32), np.array([[[0, 2]]])
    nearest(
        two, two, np.array([0, 2]), both, np.zeros(2, np.int64), -np.eye(2, dtype=np.float32), two[0].copy()
    )
