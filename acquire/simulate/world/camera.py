"""The true camera: projection in OpenCV's terms, its inverse, and the same in the terms of a certificate."""

from typing import Annotated, Self

import numpy as np
from pydantic import Field, FiniteFloat, PositiveFloat

from photocal.base.arrays import Flags, Floats
from photocal.base.checked_toml import Table

OPENCV = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


class TrueCamera(Table):
    """A camera with radial and tangential distortion; pixel centres are whole numbers, rows go down.

    nominal_mm: what the makers say (EXIF, start value of a calibration).
    fx, fy, cx, cy: px.
    k1, k2, p1, p2, k3: in units of the principal distance.
    """

    id: str = "cam"
    size_px: tuple[Annotated[int, Field(ge=64)], Annotated[int, Field(ge=64)]]
    pitch_mm: PositiveFloat
    nominal_mm: PositiveFloat
    fx: PositiveFloat
    fy: PositiveFloat
    cx: FiniteFloat
    cy: FiniteFloat
    k1: FiniteFloat = 0.0
    k2: FiniteFloat = 0.0
    p1: FiniteFloat = 0.0
    p2: FiniteFloat = 0.0
    k3: FiniteFloat = 0.0
    readout_s: Annotated[FiniteFloat, Field(ge=0)] = 0.0
    exposure_s: Annotated[FiniteFloat, Field(ge=0)] = 0.0005
    estimate: tuple[str, ...] = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2", "B1")

    @property
    def width(self) -> int:
        """Columns of the image."""
        return self.size_px[0]

    @property
    def height(self) -> int:
        """Rows of the image."""
        return self.size_px[1]

    def zoomed(self, factor: float) -> Self:
        """Give the camera with a longer principal distance; the distortion stays in the image plane."""
        # k1 counts r^2 in principal distances.
        powers = {"fx": 1, "fy": 1, "k1": 2, "k2": 4, "k3": 6, "p1": 1, "p2": 1}
        return self.model_copy(update={n: getattr(self, n) * factor**power for n, power in powers.items()})

    def project(self, points: Floats) -> Floats:
        """Give columns and rows of points in OpenCV's camera axes (x right, y down, z forward).

        points (..., 3).
        returns (..., 2): px; NaN behind the camera and where the polynomial turns back, far outside the
            image. Source: OpenCV 4 documentation, calib3d, "Detailed Description".
        """
        depth = np.where(points[..., 2] > 0, points[..., 2], np.nan)
        plane = points[..., :2] / depth[..., None]
        # Beyond the image the polynomial may fold points back into it.
        reach = 1.3 * np.hypot(self.width / self.fx, self.height / self.fy) / 2
        outside = np.hypot(plane[..., 0], plane[..., 1]) > reach
        pixels = self._distorted(plane) * [self.fx, self.fy] + [self.cx, self.cy]
        return np.asarray(np.where(outside[..., None], np.nan, pixels))

    def directions(self, pixels: Floats) -> Floats:
        """Give the directions seen at columns and rows, in OpenCV's axes with z = 1, shape (..., 3)."""
        wanted = (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        plane = wanted.copy()
        for _ in range(50):
            correction = wanted - self._distorted(plane)
            plane = plane + correction
            if np.abs(correction).max() < 1e-13:
                break
        return np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)

    def sees(self, pixels: Floats, margin_px: float = 0.0) -> Flags:
        """Tell which columns and rows lie in the image, `margin_px` from its border."""
        column, row = pixels[..., 0], pixels[..., 1]
        inside = (column >= margin_px) & (column <= self.width - 1 - margin_px)
        return np.asarray(inside & (row >= margin_px) & (row <= self.height - 1 - margin_px))

    def _distorted(self, plane: Floats) -> Floats:
        x, y = plane[..., 0], plane[..., 1]
        r2 = x**2 + y**2
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        across = x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x**2)
        down = y * radial + self.p1 * (r2 + 2 * y**2) + 2 * self.p2 * x * y
        return np.stack([across, down], axis=-1)

    def certificate_terms(self, unit: str) -> dict[str, float]:
        """Give the same camera as `brown-ideal`, affinity `after`, y up from the middle of the image."""
        # With x = c u and y = -c v the radial term k1 r^2 becomes K1 = k1 / c^2; of the tangential ones p2
        # belongs to x in OpenCV and P1 does so here, and the turned y axis changes the sign of p1.
        scale = self.pitch_mm if unit == "mm" else 1.0
        c = self.fy * scale
        return {
            "c": c,
            "x0": (self.cx - (self.width - 1) / 2) * scale,
            "y0": ((self.height - 1) / 2 - self.cy) * scale,
            "K1": self.k1 / c**2,
            "K2": self.k2 / c**4,
            "K3": self.k3 / c**6,
            "P1": self.p2 / c,
            "P2": -self.p1 / c,
            "B1": self.fx / self.fy - 1,
        }
