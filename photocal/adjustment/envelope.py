"""Symmetric matrices with a band and a border: Cholesky factor, solution and selected inverse.

The lower triangle is kept in panels of some hundred columns, each dense from its diagonal to the last
row that its columns, or any before them, reach; below stand the rows of the border. All arithmetic is
done panel by panel with dense kernels of the linear algebra library. A small matrix is one panel.
"""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cache, wraps
from typing import ParamSpec, TypeVar

import numpy as np
from scipy.linalg import blas, lapack
from threadpoolctl import ThreadpoolController

from photocal.adjustment.kernels.data import Structure
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.compiled import each_piece

PANEL = 144
# Rows of a product that are worth a thread, and so many threads at most; rows below a panel of a factor from
# which on panels are worth one.
ROWS, SHARES, LARGE = 256, 8, 2000
Asked = ParamSpec("Asked")
Made = TypeVar("Made")


def envelope(reach: Integers, block: int, border: int, columns: int = PANEL, lens: int = 0) -> Structure:
    """Make the structure from how far down each block of columns reaches.

    reach (blocks,): one past the last row that is not zero in the columns of each block.
    columns: of a panel; rounded to whole blocks.
    lens: columns of the border that belong to the cameras.
    """
    band = len(reach) * block
    panel = max(columns // block, 1) * block
    starts = np.arange(0, band, panel)
    # The factor fills each row from its first entry on: no panel may end before an earlier one.
    running = np.maximum.accumulate(reach) if band else reach
    ends = np.minimum(starts + panel, band)
    last = running[ends // block - 1] if band else np.zeros(0, dtype=np.int64)
    width = np.append(ends - starts, border)
    rows = np.append(last - starts + border, border)
    offset = np.concatenate([[0], np.cumsum(rows * width)])
    return Structure(panel, last, width, offset, band, border, lens)


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Keep the linear algebra to one thread: with the kernels' threads waiting beside it, two are slower."""
    limited: AbstractContextManager[object] = _libraries().limit(limits=1, user_api="blas")
    return limited


def on_one_thread(function: Callable[Asked, Made]) -> Callable[Asked, Made]:
    """Keep the linear algebra of all that a function does to one thread."""

    @wraps(function)
    def alone(*arguments: Asked.args, **named: Asked.kwargs) -> Made:
        """Call it so."""
        with one_thread():
            return function(*arguments, **named)

    return alone


def factorise(structure: Structure, values: Floats, known: Floats | None = None, same: int = 0) -> int:
    """Replace a matrix by its Cholesky factor, in place.

    known: factor of a matrix with the same elements in the first `same` columns.

    returns: -1, or the column at which the matrix is not positive definite.
    """
    alike = [] if known is None else structure.panels(known)[: same // structure.panel]
    with one_thread():
        return _factorised(structure, structure.panels(values), alike)


def _factorised(structure: Structure, panels: list[Floats], known: list[Floats]) -> int:
    for j, panel in enumerate(panels):
        here, _, width = _places(structure, j)
        if width == 0:
            continue
        if j < len(known):
            panel[:] = known[j]
            _update_later(structure, panels, j, panel[width:].T, len(known))
            continue
        # The transposed view of a C panel is what Fortran takes; its upper factor is our lower one.
        diagonal = panel[:width].T
        _, info = lapack.dpotrf(diagonal, lower=0, overwrite_a=1, clean=0)
        if info > 0:
            return int(here.start + info - 1)
        below = panel[width:].T
        if below.shape[1] == 0:
            continue
        blas.dtrsm(1.0, diagonal, below, side=0, lower=0, trans_a=1, overwrite_b=1)
        _update_later(structure, panels, j, below)
    return -1


def _reached(structure: Structure, begin: int, last: int) -> range:
    """Panels from one on that begin above a row of the band."""
    return range(begin, min(math.ceil(last / structure.panel), len(structure.last)))


def _update_later(structure: Structure, panels: list[Floats], j: int, below: Floats, begin: int = 0) -> None:
    """Subtract the outer product of panel j's rows from the panels, some first ones left out, they reach."""
    first = structure.start(j) + int(structure.width[j])
    last = int(structure.last[j]) if j < len(structure.last) else first
    border = below[:, last - first :]
    reached = _reached(structure, max(j + 1, begin), last)
    large = below.shape[1] >= LARGE

    def work(place: int) -> None:
        """Subtract from one panel."""
        k = reached[place]
        top = structure.start(k)
        stop = min(top + int(structure.width[k]), last)
        rows, target = below[:, top - first : stop - first], panels[k][:, : stop - top]
        _subtract(target[: last - top], below[:, top - first : last - first], rows, beside=large)
        _subtract(target[int(structure.last[k]) - top :], border, rows, beside=large)

    if large:
        each_piece(len(reached), work)
    else:
        for place in range(len(reached)):
            work(place)
    if structure.border and j < len(structure.last):
        _subtract(panels[-1], border, border)


def _subtract(target: Floats, left: Floats, right: Floats, *, beside: bool = False) -> None:
    """Subtract left' right from the target: (m, n) -= (k, m)' (k, n).

    beside: whether other threads do so, too: the library's own function would keep the interpreter's lock.
    """
    if target.shape[0] and target.shape[1]:
        if not beside and target.base is not None and target.T.flags.f_contiguous:
            blas.dgemm(-1.0, right, left, beta=1.0, c=target.T, trans_a=1, overwrite_c=1)
        else:
            target -= left.T @ right


def solve(structure: Structure, factor: Floats, right: Floats) -> Floats:
    """Solve with a factorised matrix.

    right (n,) or (n, m): right-hand sides.

    returns: ndarray, shape of `right`
    """
    x = np.array(right.reshape(structure.size, -1))
    with one_thread():
        _substitute(structure, structure.panels(factor), x)
    return x.reshape(right.shape)


def _substitute(structure: Structure, panels: list[Floats], x: Floats) -> None:
    """Solve in place: forward, then back."""
    border = x[structure.band :]
    for j, panel in enumerate(panels):
        here, rows, width = _places(structure, j)
        if width:
            x[here] = blas.dtrsm(1.0, panel[:width].T, x[here], lower=0, trans_a=1)
            if j < len(structure.last):
                split = width + rows.stop - rows.start
                x[rows] -= panel[width:split] @ x[here]
                border -= panel[split:] @ x[here]
    for j in reversed(range(len(panels))):
        panel, (here, rows, width) = panels[j], _places(structure, j)
        if width:
            part = x[here]
            if j < len(structure.last):
                split = width + rows.stop - rows.start
                part = part - panel[width:split].T @ x[rows] - panel[split:].T @ border
            x[here] = blas.dtrsm(1.0, panel[:width].T, part, lower=0)


def _places(structure: Structure, j: int) -> tuple[slice, slice, int]:
    """Columns of panel j, the rows of the band below its diagonal block, and its width."""
    top, width = structure.start(j) if j < len(structure.last) else structure.band, int(structure.width[j])
    last = int(structure.last[j]) if j < len(structure.last) else top + width
    return slice(top, top + width), slice(top + width, last), width


def _rows(structure: Structure, j: int) -> Integers:
    """Rows below the diagonal block of panel j."""
    if j == len(structure.last):
        return np.zeros(0, dtype=np.int64)
    _, rows, _ = _places(structure, j)
    return np.concatenate([np.arange(rows.start, rows.stop), np.arange(structure.band, structure.size)])


def selected_inverse(structure: Structure, factor: Floats) -> Floats:
    """Elements of the inverse within the structure (Takahashi, Fagan and Chin 1973, by panels).

    returns: values of the inverse's lower triangle; the diagonal blocks are complete.
    """
    inverse = structure.zeros()
    with one_thread():
        _invert(structure, structure.panels(factor), structure.panels(inverse))
    return inverse


def border_inverse(structure: Structure, factor: Floats) -> Floats:
    """Elements of the inverse within the border, as `selected_inverse` has them; all others are zero."""
    inverse = structure.zeros()
    if structure.border:
        structure.panels(inverse)[-1][:] = _inverse_of(structure.panels(factor)[-1])[0]
    return inverse


def _inverse_of(factor: Floats) -> tuple[Floats, Floats]:
    """Inverse of a matrix from its Cholesky factor, and that of the factor."""
    root = lapack.dtrtri(np.tril(factor), lower=1)[0]
    return root.T @ root, root


def _invert(structure: Structure, factors: list[Floats], results: list[Floats]) -> None:
    for j in reversed(range(len(factors))):
        width = int(structure.width[j])
        if width == 0:
            continue
        results[j][:width], root = _inverse_of(factors[j][:width])
        if len(factors[j]) == width:
            continue
        scaled = factors[j][width:] @ root
        product = _by_inverse(structure, results, j, scaled)
        results[j][width:] = -product
        results[j][:width] += scaled.T @ product


def _by_inverse(structure: Structure, results: list[Floats], j: int, right: Floats) -> Floats:
    """Product of a matrix with the inverse among the rows below panel j, of which the lower triangle is kept.

    Panel by panel: to make the symmetric matrix whole takes as long as the product. Shares of the panels,
    which threads take, do not depend on the number of threads: the product has the same digits with any.
    """
    first = structure.start(j) + int(structure.width[j])
    last = int(structure.last[j])
    band = last - first
    panels = _reached(structure, j + 1, last)
    shares = np.zeros((min(SHARES, 1 + len(right) // ROWS), *right.shape))

    def work(share: int) -> None:
        """Multiply by one share of the panels."""
        part = shares[share]
        for k in panels[share :: len(shares)]:
            top = structure.start(k)
            stop = min(top + int(structure.width[k]), last)
            here, later = slice(top - first, stop - first), slice(stop - first, band)
            panel = results[k][:, : stop - top]
            own, below = panel[: stop - top], panel[stop - top : last - top]
            border = panel[int(structure.last[k]) - top :]
            part[here] += own @ right[here]
            part[here] += below.T @ right[later]
            part[here] += border.T @ right[band:]
            part[later] += below @ right[here]
            part[band:] += border @ right[here]

    each_piece(len(shares), work)
    shares[0, band:] += results[-1] @ right[band:]
    return np.asarray(shares.sum(axis=0))


def product(structure: Structure, factor: Floats) -> Floats:
    """Matrix of a Cholesky factor."""
    values = structure.zeros()
    panels = structure.panels(values)
    with one_thread():
        for j, (factor_panel, panel) in enumerate(zip(structure.panels(factor), panels, strict=True)):
            width = int(structure.width[j])
            diagonal = np.tril(factor_panel[:width])
            panel[:width] -= diagonal @ diagonal.T
            panel[width:] -= factor_panel[width:] @ diagonal.T
            _update_later(structure, panels, j, factor_panel[width:].T)
    return np.negative(values, out=values)


def clear(structure: Structure, values: Floats, columns: Flags) -> None:
    """Set rows and columns of a matrix, given by its lower triangle, to zero."""
    for j, panel in enumerate(structure.panels(values)):
        here, _, width = _places(structure, j)
        panel[:, columns[here]] = 0.0
        panel[:width][columns[here]] = 0.0
        panel[width:][columns[_rows(structure, j)]] = 0.0


def multiply(structure: Structure, values: Floats, x: Floats) -> Floats:
    """Multiply a matrix of a structure, given by its lower triangle, with vectors of shape (n, m)."""
    product = np.zeros_like(x)
    for j, panel in enumerate(structure.panels(values)):
        rows, (here, _, width) = _rows(structure, j), _places(structure, j)
        if width == 0:
            continue
        lower = np.tril(panel[:width])
        product[here] += lower @ x[here] + np.tril(lower, -1).T @ x[here] + panel[width:].T @ x[rows]
        product[rows] += panel[width:] @ x[here]
    return product


def dense(structure: Structure, values: Floats) -> Floats:
    """Matrix of a structure as a full symmetric array, shape (n, n)."""
    full = np.zeros((structure.size, structure.size))
    for j, panel in enumerate(structure.panels(values)):
        here, _, width = _places(structure, j)
        full[here, here] = np.tril(panel[:width])
        full[_rows(structure, j), here] = panel[width:]
    return full + np.tril(full, -1).T
