"""Residuals over the sensor: cells in which they point the same way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Flags, Floats, Integers

RAYS_PER_CELL = 20


@dataclass(frozen=True)
class ResidualMap:
    """Mean residuals on a grid of cells over the sensor.

    columns_px, rows_px: borders of the cells, px.
    count (rows, columns): rays in each cell.
    mean_px (rows, columns, 2): mean residual (computed minus measured), column to the right and row down, px;
        NaN in empty cells.
    p_value (rows, columns): probability of so large a mean of standardised residuals without a systematic
        part.
    significant (rows, columns): cells below the level, shared among all cells.
    global_statistic, global_p_value: chi-squared of all cells together, and its probability.
    cells: number of cells that were tested.
    """

    columns_px: Floats
    rows_px: Floats
    count: Integers
    mean_px: Floats
    p_value: Floats
    significant: Flags
    global_statistic: float
    global_p_value: float
    cells: int


def residual_map(
    size_px: tuple[int, int],
    pixel: Floats,
    residual_px: Floats,
    standardised: Floats,
    variance_factor: float,
    level: float = 0.01,
) -> ResidualMap:
    """Test residuals for a pattern that is fixed to the sensor.

    The standardised residuals of a cell are taken as independent. The adjustment makes their sums smaller
    than that, so the test alarms less often than its level says: of 140 clean flights its two
    parts stayed below 5 % in 5, where 14 are expected, and below 1 % in none.

    pixel (n, 2): measured column and row, px.
    residual_px (n, 2): residuals in the same axes, px.
    standardised (n, 2): standardised residuals in the same axes; NaN where nothing checks a ray.
    variance_factor: variance of unit weight that the standardised residuals are judged by.
    """
    from scipy import stats

    columns, rows = grid_shape(size_px, len(pixel))
    column_edges = np.linspace(-0.5, size_px[0] - 0.5, columns + 1)
    row_edges = np.linspace(-0.5, size_px[1] - 0.5, rows + 1)
    checked = np.all(np.isfinite(standardised), axis=1)
    at_column = np.clip(np.digitize(pixel[checked, 0], column_edges) - 1, 0, columns - 1)
    at_row = np.clip(np.digitize(pixel[checked, 1], row_edges) - 1, 0, rows - 1)
    cell = at_row * columns + at_column
    count = np.bincount(cell, minlength=rows * columns)
    sums = np.column_stack([np.bincount(cell, residual_px[checked, a], rows * columns) for a in (0, 1)])
    w = standardised[checked] / np.sqrt(variance_factor)
    totals = np.column_stack([np.bincount(cell, w[:, a], rows * columns) for a in (0, 1)])
    filled = np.maximum(count, 1)
    statistic = np.sum(totals**2, axis=1) / filled
    tested = count > 0
    p_value = np.where(tested, stats.chi2.sf(statistic, 2), 1.0)
    cells = int(tested.sum())
    mean = np.where(tested[:, None], sums / filled[:, None], np.nan)
    whole = float(statistic[tested].sum())
    return ResidualMap(
        column_edges,
        row_edges,
        count.reshape(rows, columns),
        mean.reshape(rows, columns, 2),
        p_value.reshape(rows, columns),
        (p_value < 1.0 - (1.0 - level) ** (1.0 / max(cells, 1))).reshape(rows, columns),
        whole,
        float(stats.chi2.sf(whole, 2 * cells)) if cells else 1.0,
        cells,
    )


def grid_shape(size_px: tuple[int, int], rays: int) -> tuple[int, int]:
    """Choose how many cells the rays can fill."""
    wanted = max(1.0, rays / RAYS_PER_CELL)
    columns = int(np.clip(np.sqrt(wanted * size_px[0] / size_px[1]), 1, 12))
    return columns, max(1, round(columns * size_px[1] / size_px[0]))
