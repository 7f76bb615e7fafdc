"""Radiometry of a camera: MTF at a slanted edge, a Siemens star, vignetting, linearity."""

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import fmin

from photocal.base.arrays import Floats
from photocal.base.console import numbers_of
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.measurement.image_facts import read_facts
from photocal.measurement.image_file import Grey, list_images, read_grey
from photocal.measurement.options import RadiometryOptions

# Least and largest slant of an edge (ISO 12233 takes 5 degrees).
SLANT_DEG = (1.0, 40.0)


def measure_radiometry(options: RadiometryOptions) -> dict[str, float]:
    """Measure what pictures of an edge, a star and an even surface tell of a camera.

    Parameters
    ----------
    options
        Pictures with linear grey values, and where in them (px) edge and star are.

    Returns
    -------
    dict
        Figures by names that end with their unit, with four digits; those of pictures that are named.

    Raises
    ------
    ConfigurationError
        When no picture is named, or a place is none.
    InputMalformedError
        When a picture does not show what it should.
    """
    figures: dict[str, float] = {}
    if options.edge is None and options.star is None and options.flat is None:
        raise ConfigurationError("there is nothing to measure", remedy="give --edge, --star or --flat")
    # Contrast that counts as resolved, of that of large parts.
    resolved = 0.10
    if options.edge is not None:
        grey = read_grey(options.edge)
        if options.region is not None:
            form = "COLUMN,ROW,WIDTH,HEIGHT: px"
            column, row, width, height = map(int, numbers_of(options.region, "--region", form))
            if not (
                0 <= column < column + width <= grey.shape[1] and 0 <= row < row + height <= grey.shape[0]
            ):
                raise ConfigurationError(
                    f"--region {options.region} is not within the picture of "
                    f"{grey.shape[1]} x {grey.shape[0]} px",
                    remedy=f"give {form}",
                )
            grey = grey[row : row + height, column : column + width]
        with _of(options.edge):
            frequency, transfer, figures["edge_slant_deg"] = edge_mtf(grey)
        figures["mtf50_cycles_px"] = falls_to(frequency, transfer, 0.5)
        figures["mtf10_cycles_px"] = falls_to(frequency, transfer, resolved)
        figures["mtf_at_nyquist"] = float(np.interp(0.5, frequency, transfer))
    if options.star is not None and options.place is not None:
        across, down, radius = numbers_of(options.place, "--place", "COLUMN,ROW,RADIUS: px")
        grey = read_grey(options.star)
        with _of(options.star):
            frequency, contrast = siemens_star(grey, (across, down), radius, options.spokes)
        limit = figures["star_limit_cycles_px"] = falls_to(frequency, contrast, resolved)
        if options.gsd_cm is not None:
            figures["ground_resolution_cm"] = options.gsd_cm / limit
    if options.flat is not None:
        pictures = ((read_facts(path).exposure_s, read_grey(path)) for path in list_images(options.flat))
        with _of(options.flat):
            figures |= even_surface(pictures)
    return {name: float(f"{value:.4g}") for name, value in figures.items() if math.isfinite(value)}


@contextmanager
def _of(picture: Path) -> Iterator[None]:
    """Name the picture that does not show what it should."""
    try:
        yield
    except InputMalformedError as refusal:
        refusal.where = refusal.where or str(picture)
        raise


def edge_mtf(grey: Grey | Floats) -> tuple[Floats, Floats, float]:
    """Measure the modulation transfer function across one slanted edge (ISO 12233, e-SFR).

    grey (rows, columns): linear grey values about one straight edge that crosses all rows, or all columns.
    returns: frequencies (cycles per pixel, 0 to 1), the function there, and the slant in degrees.
    raises InputMalformedError: where there is no such edge.
    """
    values = np.asarray(grey, dtype=float)
    if np.abs(np.diff(values, axis=0)).sum() > np.abs(np.diff(values, axis=1)).sum():
        values = values.T
    rows, columns = values.shape
    slope = np.abs(np.gradient(values, axis=1)) * np.hamming(columns)
    # Again about the first line, so that noise far from the edge weighs nothing.
    at, row = np.arange(columns, dtype=float), np.arange(rows, dtype=float)
    near, line = np.ones_like(slope), np.zeros(2)
    for _ in range(3):
        line = np.polyfit(row, (slope * near) @ at / np.maximum((slope * near).sum(axis=1), 1e-12), 1)
        near = np.abs(at - np.polyval(line, row)[:, None]) < max(4.0, columns / 8)
    slant = float(np.degrees(np.arctan(abs(line[0]))))
    inside = min(np.polyval(line, [0, rows - 1])) > 2 and max(np.polyval(line, [0, rows - 1])) < columns - 3
    if not (SLANT_DEG[0] <= slant <= SLANT_DEG[1] and inside and rows >= 16):
        raise InputMalformedError(
            f"has no slanted edge (slant {slant:.1f} degrees, {columns} x {rows} px)",
            remedy="cut out one straight edge, slanted by about 5 degrees, away from its ends",
        )
    across = (at - np.polyval(line, row)[:, None]) * np.cos(np.arctan(line[0]))
    # Bins of an edge for each pixel.
    oversampling = 4
    reach = int(oversampling * np.floor(min(across.max(), -across.min()) - 1))
    index = np.round(across * oversampling).astype(int)
    used = np.abs(index) <= reach
    count = np.bincount(index[used] + reach, minlength=2 * reach + 1)
    spread = np.bincount(index[used] + reach, values[used], 2 * reach + 1) / np.maximum(count, 1)
    spread = np.interp(np.arange(len(spread)), np.flatnonzero(count), spread[count > 0])
    line_spread = np.gradient(spread)[1:-1] * np.hamming(len(spread) - 2)
    spectrum = np.abs(np.fft.rfft(line_spread))
    frequency: Floats = np.fft.rfftfreq(len(line_spread), 1.0 / oversampling).astype(np.float64)
    # The difference over two bins and the width of a bin are filters of the method, not of the camera.
    response = np.sinc(2.0 * frequency / oversampling) * np.sinc(frequency / oversampling)
    low = frequency <= 1.0
    return np.asarray(frequency[low]), np.asarray(spectrum[low] / spectrum[0] / response[low]), slant


def falls_to(frequency: Floats, transfer: Floats, level: float) -> float:
    """Give the frequency at which a transfer function first falls to a level; NaN where it does not."""
    below = np.flatnonzero(transfer < level)
    if not len(below) or below[0] == 0:
        return float("nan")
    k = below[0]
    return float(np.interp(-level, -transfer[k - 1 : k + 1], frequency[k - 1 : k + 1]))


def siemens_star(
    grey: Grey | Floats, centre: tuple[float, float], radius: float, spokes: int
) -> tuple[Floats, Floats]:
    """Measure contrast over frequency in a Siemens star (Loebich et al. 2007).

    centre, radius: about, column and row, px; spokes: pairs of a bright and a dark sector.
    returns: frequencies (cycles per pixel, rising) and contrast relative to that of the outer rim.
    raises InputMalformedError: where there is no star.
    """
    values = np.asarray(grey, dtype=float)
    row, column = np.indices(values.shape)

    def contrast(middle: Floats, radii: Floats) -> tuple[Floats, float]:
        """Of rings, and the share of the first one's variance that is the star."""
        x, y = column - middle[0], row - middle[1]
        apart, angle = np.hypot(x, y), np.arctan2(y, x)
        contrasts, shares = [], []
        for r in radii:
            ring = np.abs(apart - r) < 0.7
            turn = spokes * angle[ring]
            design = np.column_stack([np.ones(len(turn)), np.cos(turn), np.sin(turn)])
            mean, a, b = np.linalg.lstsq(design, values[ring], rcond=None)[0]
            contrasts.append(np.hypot(a, b) / max(abs(mean), 1e-12))
            shares.append((a**2 + b**2) / 2.0 / max(float(np.var(values[ring])), 1e-12))
        return np.array(contrasts), float(shares[0])

    smallest = max(4.0, spokes / np.pi)
    if radius < 2 * smallest or not all(
        radius < c < n - radius for c, n in zip(centre, values.shape[::-1], strict=True)
    ):
        raise InputMalformedError(
            "has no complete star there", remedy="give column, row and radius of the star, in pixels"
        )
    inner = radius * np.array([0.4, 0.6, 0.8])
    corners = np.array(centre) + np.array([[0, 0], [2, 0], [0, 2]])
    search: Any = fmin
    middle = search(
        lambda at: -contrast(at, inner)[0].sum(), centre, xtol=0.01, initial_simplex=corners, disp=0
    )
    radii = np.geomspace(0.95 * radius, smallest, 60)
    contrasts, share = contrast(middle, radii)
    # Sectors of two tones have 8 / pi^2 of their variance in the first harmonic.
    if share < 0.4 or contrasts[:6].mean() < 0.05:
        raise InputMalformedError(f"has no star of {spokes} spokes there", remedy="count its bright sectors")
    return spokes / (2.0 * np.pi * radii), contrasts / contrasts[:6].mean()


def even_surface(pictures: Iterable[tuple[float, Grey]]) -> dict[str, float]:
    """Measure vignetting and linearity in pictures of an even surface with their exposure times (s).

    raises InputMalformedError: where all are saturated, or by `linearity`.
    """
    total: Floats | float = 0.0
    exposures, means = [], []
    # A picture of an even surface is not used where more of its pixels are saturated.
    saturated = 0.01
    for time, grey in pictures:
        full = 255 if grey.dtype == np.uint8 else grey.max()
        if np.mean(grey >= full) > saturated:
            continue
        rows, columns = (slice(n // 3, n - n // 3) for n in grey.shape)
        means.append(float(grey[rows, columns].mean()))
        exposures.append(time)
        total = total + np.asarray(grey, dtype=np.float64) / means[-1]
    if not means:
        raise InputMalformedError("the flat field is saturated in all pictures", remedy="expose it again")
    figures = {"corner_brightness": vignetting(np.asarray(total))[0]}
    known = np.isfinite(exposures)
    if len(np.unique(np.array(exposures)[known])) > 1:
        error, correlation = linearity(np.array(exposures)[known], np.array(means)[known])
        figures |= {"linearity_error": error, "linearity_r2": correlation}
    return figures


def vignetting(flat: Floats) -> tuple[float, Floats]:
    """Fit the vignetting in a picture of an even surface: 1 + a r^2 + b r^4 + c r^6, r 1 in the corners.

    returns: brightness of the corners as a share of the middle's, and a, b, c.
    """
    values = np.asarray(flat, dtype=float)
    rows, columns = values.shape
    y, x = np.indices(values.shape)
    square = ((x - (columns - 1) / 2) ** 2 + (y - (rows - 1) / 2) ** 2).ravel()
    r2 = square / square.max()
    fit = np.linalg.lstsq(np.column_stack([r2**0, r2, r2**2, r2**3]), values.ravel(), rcond=None)[0]
    return float(fit.sum() / fit[0]), np.asarray(fit[1:] / fit[0])


def linearity(exposure: Floats, mean: Floats) -> tuple[float, float]:
    """Fit grey values over exposures by a line.

    returns: its largest deviation as a share of the range that was seen (EMVA 1288), and the square of the
        correlation.
    raises InputMalformedError: for fewer than three different exposures.
    """
    if len(np.unique(exposure)) < 3:
        raise InputMalformedError(
            "the flat field has fewer than three exposure times", remedy="expose it at three or more"
        )
    left = mean - np.polyval(np.polyfit(exposure, mean, 1), exposure)
    correlation = float(np.corrcoef(exposure, mean)[0, 1])
    return float(np.abs(left).max() / np.ptp(mean)), correlation**2
