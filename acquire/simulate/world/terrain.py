"""Fractal relief: a random surface, smooth to its second derivative."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from acquire.simulate.world import configuration

Floats = NDArray[np.float64]

STEP_M = 2.0


@dataclass(frozen=True)
class Terrain:
    """A height field over a square around the origin.

    Attributes
    ----------
    coefficients : ndarray, shape (n, n)
        Of the cubic spline through heights at steps of `STEP_M`; rows north, columns east.
    half_m : float
        Half the side of the square.
    """

    coefficients: Floats
    half_m: float

    def height(self, east_m: Floats, north_m: Floats) -> Floats:
        """Give the height at places; outside the square that of its border."""
        rows, columns = ((np.asarray(axis) + self.half_m) / STEP_M for axis in (north_m, east_m))
        heights = map_coordinates(
            self.coefficients, [rows, columns], order=3, mode="nearest", prefilter=False
        )
        return np.asarray(heights)

    def intersect(self, start_m: Floats, direction: Floats, steps: int = 14) -> Floats:
        """Give where rays meet the ground.

        Parameters
        ----------
        start_m, direction : ndarray, shape (n, 3)
            The rays; the directions point downwards.
        steps : int
            Steps of the secant method; the first ones go from the mean height.

        Returns
        -------
        ndarray, shape (n, 3)
            The points, m.
        """
        mean = float(self.coefficients.mean())
        before = (mean + 1.0 - start_m[:, 2]) / direction[:, 2]
        now = (mean - start_m[:, 2]) / direction[:, 2]
        miss_before = self._miss(start_m, direction, before)
        for _ in range(steps):
            miss = self._miss(start_m, direction, now)
            if np.abs(miss).max() < 1e-7:
                break
            change = miss - miss_before
            slope = np.where(np.abs(change) > 1e-12, change, 1.0)
            step = np.where(np.abs(change) > 1e-12, miss * (now - before) / slope, 0.0)
            before, miss_before, now = now, miss, now - step
        return np.asarray(start_m + now[:, None] * direction)

    def _miss(self, start_m: Floats, direction: Floats, along: Floats) -> Floats:
        point = start_m + along[:, None] * direction
        return np.asarray(point[:, 2] - self.height(point[:, 0], point[:, 1]))


def make_terrain(given: configuration.Terrain, half_m: float, random: np.random.Generator) -> Terrain:
    """Draw a surface.

    Parameters
    ----------
    given : configuration.Terrain
    half_m : float
        Half the side of the square that it must cover.
    random : Generator

    Returns
    -------
    Terrain

    Notes
    -----
    White noise filtered to a power spectrum k^-exponent below the longest wave (spectral synthesis; Saupe
    1988, in The Science of Fractal Images, section 2.5). Waves shorter than four steps are left out.
    """
    reach = half_m + 20.0
    count = 2 * int(np.ceil(reach / STEP_M)) + 1
    # Drawn on twice the square: the transform repeats, the square must not.
    size = 2 * count
    wave = np.hypot(*np.meshgrid(np.fft.fftfreq(size, STEP_M), np.fft.rfftfreq(size, STEP_M), indexing="ij"))
    longest = 1 / given.longest_m
    amplitude = np.where(wave > 0, np.maximum(wave, longest) ** (-given.exponent / 2), 0.0)
    amplitude[wave > 1 / (4 * STEP_M)] = 0.0
    noise = np.fft.rfft2(random.standard_normal((size, size)))
    surface = np.fft.irfft2(noise * amplitude, s=(size, size))[:count, :count]
    surface = surface - surface.mean()
    spread = float(surface.std())
    heights = surface * (given.relief_m / spread) if spread > 0 else surface
    return Terrain(np.asarray(spline_filter(heights, order=3, mode="nearest")), (count - 1) / 2 * STEP_M)
