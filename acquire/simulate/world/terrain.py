"""Fractal relief: a random surface, smooth to its second derivative."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from acquire.simulate.world import configuration
from photocal.base.arrays import Floats

STEP_M = 2.0
# A ray meets the ground when it misses it by less.
_MEETS_M, _MOST_STEPS = 1e-7, 60


@dataclass(frozen=True)
class HeightField:
    """A height field over a square around the origin.

    coefficients (n, n): of the cubic spline through heights at steps of `STEP_M`; rows north, columns east.
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

    def intersect(self, start_m: Floats, direction: Floats) -> Floats:
        """Give where rays first meet the ground."""
        # A spline stays within its coefficients.
        limits = self.coefficients.max() + 1, self.coefficients.min() - 1
        above, below = ((height - start_m[:, 2]) / direction[:, 2] for height in limits)
        flatness = np.hypot(direction[:, 0], direction[:, 1]) / -direction[:, 2]
        # A ray steeper than any slope goes into the ground once; others may come out of a hill again.
        grazing = np.flatnonzero(flatness * self._steepest >= 1.0)
        if len(grazing):
            rays = start_m[grazing], direction[grazing]
            above[grazing], below[grazing] = self._first(*rays, above[grazing], below[grazing])
        along = self._between(start_m, direction, above, below)
        return np.asarray(start_m + along[:, None] * direction)

    @cached_property
    def _steepest(self) -> float:
        """Bound of the slope: that of the nodes, and something for what lies between."""
        places = np.indices(self.coefficients.shape)
        nodes = map_coordinates(self.coefficients, places, order=3, mode="nearest", prefilter=False)
        down, across = np.gradient(nodes, STEP_M)
        return 1.5 * float(np.hypot(down, across).max())

    def _first(
        self, start_m: Floats, direction: Floats, above: Floats, below: Floats
    ) -> tuple[Floats, Floats]:
        """Walk along rays until they are under the ground: the last place above it, the first one below."""
        way = (below - above) * np.hypot(direction[:, 0], direction[:, 1])
        count = int(np.ceil(way.max() / (STEP_M / 2)))
        step = (below - above) / count
        first_under = np.full(len(above), count)
        left = np.arange(len(above))
        for k in range(1, count):
            here = above[left] + k * step[left]
            under = self._miss(start_m[left], direction[left], here) < 0
            first_under[left[under]] = k
            left = left[~under]
            if not len(left):
                break
        return above + (first_under - 1) * step, above + first_under * step

    def _between(self, start_m: Floats, direction: Floats, above: Floats, below: Floats) -> Floats:
        """Find the root between two places by false position (Dowell and Jarratt 1971, "Illinois")."""
        a, b = above.copy(), below.copy()
        of_a, of_b = (self._miss(start_m, direction, end) for end in (a, b))
        root = a
        for _ in range(_MOST_STEPS):
            root = b - of_b * (b - a) / np.where(of_b == of_a, 1.0, of_b - of_a)
            of_root = self._miss(start_m, direction, root)
            if np.abs(of_root).max(initial=0.0) < _MEETS_M:
                break
            across = of_root * of_b < 0
            a, of_a = np.where(across, b, a), np.where(across, of_b, of_a / 2)
            b, of_b = root, of_root
        return np.asarray(root)

    def _miss(self, start_m: Floats, direction: Floats, along: Floats) -> Floats:
        point = start_m + along[:, None] * direction
        return np.asarray(point[:, 2] - self.height(point[:, 0], point[:, 1]))


def make_terrain(given: configuration.TerrainKeys, half_m: float, random: np.random.Generator) -> HeightField:
    """Draw a surface."""
    # White noise filtered to a power spectrum k^-exponent below the longest wave (spectral synthesis; Saupe
    # 1988, in The Science of Fractal Images, section 2.5). Waves shorter than four steps are left out.
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
    return HeightField(np.asarray(spline_filter(heights, order=3, mode="nearest")), (count - 1) / 2 * STEP_M)
