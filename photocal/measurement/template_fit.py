"""Least squares template matching: a parametric picture of a target is fitted to the grey values.

The picture is an ideal edge pattern blurred by a Gaussian, in light that may change evenly across it, so its
parameters, the centre among them, come with their covariance from the noise that remains. After Foerstner and
Wrobel 2016, section 13.5 (LS matching with a model in place of the second image).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from photocal.base.arrays import Columns, Floats
from photocal.measurement.image_file import Grey

# Grey values at columns and rows, relative to the middle of the window, for a vector of parameters; for
# several of them, (k, m, 1), in rows, (m, n).
Template = Callable[[Floats, Floats, Floats], Floats]

# Settled: the next step would change the squares of the residuals by this part of their variance, so that it
# is a tenth of the standard deviation of any parameter.
_SETTLED = 1e-2
# Light changes by parts of itself per px: typical size. Without it a shadow would push the centre aside.
_UNEVEN = 0.005


@dataclass(frozen=True)
class Window(Columns):
    """Grey values around a place.

    middle: column and row of the pixel to which coordinates are relative.
    x, y (n,): column and row relative to `middle`, px.
    grey (n,).
    """

    middle: tuple[int, int]
    x: Floats
    y: Floats
    grey: Floats


@dataclass(frozen=True)
class Fit:
    """A fitted template.

    parameters (k,): place relative to the middle of the window.
    cofactor (k, k): their covariance for grey values of variance 1.
    noise: standard deviation of a grey value about the template.
    residual (n,): grey values less the template.
    basis (n, m): orthonormal columns that span what the parameters can explain.
    """

    parameters: Floats
    cofactor: Floats
    noise: float
    residual: Floats
    basis: Floats


def cut_window(grey: Grey, centre: tuple[float, float], radius: float) -> Window | None:
    """Cut a round window out of an image; None where it leaves the image."""
    if not (np.isfinite(centre[0]) and np.isfinite(centre[1])):
        return None
    column, row, reach = round(centre[0]), round(centre[1]), int(np.ceil(radius))
    height, width = grey.shape
    if column - reach < 0 or row - reach < 0 or column + reach >= width or row + reach >= height:
        return None
    return cut_part(grey, centre, radius)


def cut_part(grey: Grey, centre: tuple[float, float], radius: float) -> Window:
    """Cut what lies in the image of a round window; the centre lies in it."""
    column, row, reach = round(centre[0]), round(centre[1]), int(np.ceil(radius))
    height, width = grey.shape
    left, right = max(column - reach, 0), min(column + reach + 1, width)
    top, bottom = max(row - reach, 0), min(row + reach + 1, height)
    part = grey[top:bottom, left:right]
    y, x = np.mgrid[top - row : bottom - row, left - column : right - column].astype(float)
    inside = np.hypot(x - (centre[0] - column), y - (centre[1] - row)) <= radius
    return Window((column, row), x[inside], y[inside], part[inside].astype(float))


def fit_template(window: Window, template: Template, start: Floats, sizes: Floats) -> Fit | None:
    """Fit a template in light that changes evenly (Levenberg-Marquardt)."""
    across = np.column_stack([window.x, window.y])

    def lit(p: Floats) -> Floats:
        """Return the template under uneven light."""
        return np.asarray(template(p[:-2], window.x, window.y) * (1 + across @ p[-2:]))

    def slopes(p: Floats) -> Floats:
        """Return the derivatives of `lit` with respect to its parameters."""
        partials, light = _jacobian(window, template, p[:-2], sizes[:-2]), 1 + across @ p[-2:]
        even = template(p[:-2], window.x, window.y)
        return np.column_stack([partials * light[:, None], even[:, None] * across * _UNEVEN])

    count = len(start)
    parameters, sizes = np.r_[start.astype(float), 0, 0], np.r_[sizes, _UNEVEN, _UNEVEN]
    residual = window.grey - lit(parameters)
    lowest, damping = float(residual @ residual), 1e-3
    if len(window.grey) <= count + 6 or not np.isfinite(lowest):
        return None
    jacobian = slopes(parameters)
    settled = False
    # What is a target settles in about ten.
    iterations = 25
    for _ in range(iterations):
        normal, right = jacobian.T @ jacobian, jacobian.T @ residual
        scaled = normal + damping * np.diag(np.diag(normal) + 1e-12 * np.trace(normal))
        try:
            step = np.linalg.solve(scaled, right)
        except np.linalg.LinAlgError:
            return None
        trial = parameters + step * sizes
        left = window.grey - lit(trial)
        squares = float(left @ left)
        settled = float(step @ right) < _SETTLED * lowest / len(residual)
        if squares <= lowest:
            parameters, residual, lowest = trial, left, squares
            if settled:
                break
            jacobian = slopes(parameters)
            damping = max(damping / 8, 1e-9)
        elif settled or damping > 1e6:
            break
        else:
            damping *= 8
    if not settled:
        return None
    return _judged(parameters[:count], jacobian, residual, sizes)


def odd_variance(window: Window, fit: Fit, middle: Floats) -> float:
    """Variance of the grey values that can move the centre of a target."""
    # Targets look the same when turned by half a turn, so what is left of the grey values and looks the same,
    # too, such as a plate's edge all around or corners that are rounder than drawn, does not move their
    # centre: only the odd part does, grey values less those across the centre.
    x, y = window.x.astype(np.int64), window.y.astype(np.int64)
    # To half a pixel: noise does not mind, and other remains are smooth.
    u, v = np.round(2 * middle).astype(np.int64)
    low = min(x.min(), y.min())
    side = max(x.max(), y.max()) - low + 1
    number = np.full((side, side), -1)
    number[y - low, x - low] = np.arange(len(x))
    across_x, across_y = u - x - low, v - y - low
    inside = (across_x >= 0) & (across_x < side) & (across_y >= 0) & (across_y < side)
    pixel = np.flatnonzero(inside)
    opposite = number[across_y[pixel], across_x[pixel]]
    pixel, opposite = pixel[opposite >= 0], opposite[opposite >= 0]
    squares = float(np.sum((fit.residual[pixel] - fit.residual[opposite]) ** 2)) / 4
    taken = np.einsum("ik,ik->i", fit.basis[pixel], fit.basis[pixel] - fit.basis[opposite])
    free = float(np.sum((pixel != opposite) - taken)) / 2
    # A variance of fewer differences than this says nothing.
    fewest_free = 5
    # Grey values are whole numbers: rounding alone leaves 1/12.
    return max(squares / free, 1 / 12) if free >= fewest_free else np.inf


def _judged(parameters: Floats, jacobian: Floats, residual: Floats, sizes: Floats) -> Fit | None:
    variance = max(float(residual @ residual) / (len(residual) - len(sizes)), 1 / 12)
    try:
        inverse = np.linalg.inv(jacobian.T @ jacobian)
        root = np.linalg.cholesky(inverse)
    except np.linalg.LinAlgError:
        return None
    cofactor = (inverse * np.outer(sizes, sizes))[: len(parameters), : len(parameters)]
    if not np.isfinite(cofactor).all() or (np.diag(cofactor) < 0).any():
        return None
    return Fit(parameters, cofactor, float(np.sqrt(variance)), residual, jacobian @ root)


def _jacobian(window: Window, template: Template, parameters: Floats, sizes: Floats) -> Floats:
    steps = 1e-3 * np.diag(sizes)
    # All at once: a column of values for each parameter, against the row of pixels.
    moved = np.concatenate([parameters + steps, parameters - steps]).T[:, :, None]
    ahead, behind = np.split(template(moved, window.x, window.y), 2)
    return np.asarray((ahead - behind).T / 2e-3)
