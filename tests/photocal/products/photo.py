"""A photo taken by plain collinearity, written out here without any code of the project."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ground = Callable[[Floats, Floats], Floats]


def rotation(omega: float, phi: float, kappa: float) -> Floats:
    """Object to camera axes: R3(kappa) R2(phi) R1(omega)."""
    so, co, sp, cp = np.sin(omega), np.cos(omega), np.sin(phi), np.cos(phi)
    sk, ck = np.sin(kappa), np.cos(kappa)
    r1 = np.array([[1, 0, 0], [0, co, so], [0, -so, co]])
    r2 = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    r3 = np.array([[ck, sk, 0], [-sk, ck, 0], [0, 0, 1]])
    return np.asarray(r3 @ r2 @ r1)


@dataclass(frozen=True)
class Lens:
    """Interior orientation in mm; `observed` tells where the polynomial is evaluated."""

    c: float
    x0: float = 0.0
    y0: float = 0.0
    k: tuple[float, float, float] = (0.0, 0.0, 0.0)
    p: tuple[float, float] = (0.0, 0.0)
    observed: bool = True

    def polynomial(self, xy: Floats) -> Floats:
        x, y = xy.T
        r2 = x * x + y * y
        radial = self.k[0] * r2 + self.k[1] * r2**2 + self.k[2] * r2**3
        dx = x * radial + self.p[0] * (r2 + 2 * x * x) + 2 * self.p[1] * x * y
        dy = y * radial + self.p[1] * (r2 + 2 * y * y) + 2 * self.p[0] * x * y
        return np.column_stack([dx, dy])

    def ideal(self, plane: Floats) -> Floats:
        """Central projection of measured coordinates."""
        measured = plane - [self.x0, self.y0]
        if self.observed:
            return measured - self.polynomial(measured)
        found = measured
        for _ in range(200):
            found = measured - self.polynomial(found)
        return found

    def recorded(self, ideal: Floats) -> Floats:
        """Measured coordinates of a central projection."""
        found = ideal + self.polynomial(ideal)
        # Far outside the image the polynomial runs away; what counts there is only that it stays outside.
        for _ in range(60 if self.observed else 0):
            found = np.clip(ideal + self.polynomial(found), -100, 100)
        return np.asarray(found + np.array([self.x0, self.y0]))


@dataclass(frozen=True)
class Photo:
    """An oriented image: lens, frame in px and mm, and exterior orientation (radians, m)."""

    lens: Lens
    size: tuple[int, int]
    pitch: tuple[float, float]
    angles: tuple[float, float, float]
    station: tuple[float, float, float]

    def pixels(self, points: Floats) -> Floats:
        q = (points - self.station) @ rotation(*self.angles).T
        plane = self.lens.recorded(-self.lens.c * q[:, :2] / q[:, 2:])
        column = plane[:, 0] / self.pitch[0] + (self.size[0] - 1) / 2
        return np.column_stack([column, (self.size[1] - 1) / 2 - plane[:, 1] / self.pitch[1]])

    def ground(self, pixel: Floats, terrain: Ground) -> Floats:
        """Where the rays of pixels meet a terrain."""
        x = (pixel[:, 0] - (self.size[0] - 1) / 2) * self.pitch[0]
        y = ((self.size[1] - 1) / 2 - pixel[:, 1]) * self.pitch[1]
        ideal = self.lens.ideal(np.column_stack([x, y]))
        rays = np.column_stack([ideal, np.full(len(ideal), -self.lens.c)]) @ rotation(*self.angles)
        z = np.zeros(len(rays))
        for _ in range(60):
            place = np.array(self.station) + ((z - self.station[2]) / rays[:, 2])[:, None] * rays
            z = terrain(place[:, 0], place[:, 1])
        return np.column_stack([place[:, :2], z])
