"""Least squares template matching: a parametric picture of a target is fitted to the grey values.

The picture is an ideal edge pattern blurred by a Gaussian, so its parameters, the centre among them, come
with their covariance from the noise that remains. After Foerstner and Wrobel 2016, section 13.5 (LS
matching with a model in place of the second image).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from photocal.measurement.image_file import Grey

Floats = NDArray[np.float64]
# Grey values at columns and rows, relative to the middle of the window, for a vector of parameters.
Template = Callable[[Floats, Floats, Floats], Floats]

# What is a target settles in about ten.
_ITERATIONS = 25
_SETTLED_PX = 1e-4


@dataclass(frozen=True)
class Window:
    """Grey values around a place.

    Attributes
    ----------
    middle : tuple of int
        Column and row of the pixel to which coordinates are relative.
    x, y : ndarray, shape (n,)
        Column and row relative to `middle`, px.
    grey : ndarray, shape (n,)
    """

    middle: tuple[int, int]
    x: Floats
    y: Floats
    grey: Floats

    def where(self, mask: NDArray[np.bool_]) -> Window:
        """Keep only some pixels; mask of shape (n,)."""
        return Window(self.middle, self.x[mask], self.y[mask], self.grey[mask])


@dataclass(frozen=True)
class Fit:
    """A fitted template.

    Attributes
    ----------
    parameters : ndarray, shape (k,)
        Place relative to the middle of the window.
    covariance : ndarray, shape (k, k)
        From the noise that was found.
    noise : float
        Standard deviation of a grey value about the template.
    """

    parameters: Floats
    covariance: Floats
    noise: float


def cut_window(grey: Grey, centre: tuple[float, float], radius: float) -> Window | None:
    """Cut a round window out of an image.

    Parameters
    ----------
    grey : ndarray, shape (height, width)
    centre : tuple of float
        Column and row, px.
    radius : float
        px.

    Returns
    -------
    Window or None
        None when it does not lie inside the image.
    """
    if not (np.isfinite(centre[0]) and np.isfinite(centre[1])):
        return None
    column, row, reach = round(centre[0]), round(centre[1]), int(np.ceil(radius))
    height, width = grey.shape
    if column - reach < 0 or row - reach < 0 or column + reach >= width or row + reach >= height:
        return None
    part = grey[row - reach : row + reach + 1, column - reach : column + reach + 1]
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(float)
    inside = np.hypot(x - (centre[0] - column), y - (centre[1] - row)) <= radius
    return Window((column, row), x[inside], y[inside], part[inside].astype(float))


def fit_template(window: Window, template: Template, start: Floats, sizes: Floats) -> Fit | None:
    """Fit a template (Levenberg-Marquardt).

    Parameters
    ----------
    window : Window
    template : callable
    start : ndarray, shape (k,)
    sizes : ndarray, shape (k,)
        Typical size of each parameter; a thousandth of it is the step of the derivatives.

    Returns
    -------
    Fit or None
        None when it does not settle, or the pixels do not determine the parameters.
    """
    parameters, lowest, damping = start.astype(float), np.inf, 1e-3
    residual = window.grey - template(parameters, window.x, window.y)
    lowest = float(residual @ residual)
    if len(window.grey) <= len(start) + 4 or not np.isfinite(lowest):
        return None
    jacobian = _jacobian(window, template, parameters, sizes)
    settled = False
    for _ in range(_ITERATIONS):
        normal, right = jacobian.T @ jacobian, jacobian.T @ residual
        scaled = normal + damping * np.diag(np.diag(normal) + 1e-12 * np.trace(normal))
        try:
            step = np.linalg.solve(scaled, right)
        except np.linalg.LinAlgError:
            return None
        trial = parameters + step * sizes
        left = window.grey - template(trial, window.x, window.y)
        squares = float(left @ left)
        settled = bool(np.abs(step).max() < _SETTLED_PX)
        if squares <= lowest:
            parameters, residual, lowest = trial, left, squares
            if settled:
                break
            jacobian = _jacobian(window, template, parameters, sizes)
            damping = max(damping / 8, 1e-9)
        elif settled or damping > 1e6:
            break
        else:
            damping *= 8
    if not settled:
        return None
    return _with_covariance(window, parameters, jacobian, lowest, sizes)


def _with_covariance(
    window: Window, parameters: Floats, jacobian: Floats, squares: float, sizes: Floats
) -> Fit | None:
    variance = squares / (len(window.grey) - len(parameters))
    # Grey values are whole numbers: rounding alone leaves 1/12.
    variance = max(variance, 1 / 12)
    try:
        inverse = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return None
    covariance = variance * inverse * np.outer(sizes, sizes)
    if not np.isfinite(covariance).all() or (np.diag(covariance) < 0).any():
        return None
    return Fit(parameters, covariance, float(np.sqrt(variance)))


def _jacobian(window: Window, template: Template, parameters: Floats, sizes: Floats) -> Floats:
    columns = []
    for k, size in enumerate(sizes):
        step = np.zeros(len(parameters))
        step[k] = 1e-3 * size
        ahead = template(parameters + step, window.x, window.y)
        behind = template(parameters - step, window.x, window.y)
        columns.append((ahead - behind) / 2e-3)
    return np.column_stack(columns)
