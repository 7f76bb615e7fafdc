"""What the ground looks like: grey detail at every scale, and colours of soil, grass and light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.simulate.world.terrain import Terrain
from drivers.arrays import Bytes

COLOUR_M = 0.25
# Blue, green, red at the mean grey of the detail.
_SOIL, _GRASS = np.array([95.0, 125.0, 150.0]), np.array([62.0, 118.0, 96.0])
_SUN = np.array([-0.45, 0.45, 0.77])
_STONES_PER_M2, _STONE_M = 0.6, (0.03, 0.2)
_FADE, _CONTRAST = 0.82, 15.0
_TRACKS = 6
MEAN_GREY = 128


@dataclass(frozen=True)
class Ground:
    """A painted square around the origin, rows from north to south.

    detail (n, n): brightness, 128 where it is that of the colour.
    texel_m: size of an element of the detail.
    colour (m, m, 3): blue, green, red at steps of `COLOUR_M`.
    half_m: half the side of the square.
    """

    detail: Bytes
    texel_m: float
    colour: Bytes
    half_m: float

    def softened(self, seen_m: float) -> Ground:
        """Give the ground without detail finer than a pixel of `seen_m` on the ground can show."""
        import cv2

        sigma = 0.4 * seen_m / self.texel_m
        soft: Any = cv2.GaussianBlur(self.detail, (0, 0), sigma)
        return Ground(np.asarray(soft, np.uint8), self.texel_m, self.colour, self.half_m)

    def seen_at(self, east_m: NDArray[np.float32], north_m: NDArray[np.float32]) -> Bytes:
        """Give blue, green, red at places, shape (h, w, 3)."""
        import cv2

        parts: list[Any] = []
        for picture, step in ((self.detail, self.texel_m), (self.colour, COLOUR_M)):
            column = (east_m + self.half_m) / np.float32(step) - np.float32(0.5)
            row = (self.half_m - north_m) / np.float32(step) - np.float32(0.5)
            parts.append(cv2.remap(picture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT))
        detail, colour = parts
        return np.asarray(cv2.multiply(colour, cv2.merge([detail] * 3), scale=1 / MEAN_GREY), np.uint8)


def paint(terrain: Terrain, half_m: float, texel_m: float, random: np.random.Generator) -> Ground:
    """Paint the ground."""
    count = int(np.ceil(2 * half_m / texel_m))
    side = count * texel_m / 2
    detail = _detail(count, random)
    _scatter(detail, texel_m, random)
    return Ground(detail, texel_m, _colour(terrain, side, random), side)


def _detail(count: int, random: np.random.Generator) -> Bytes:
    """Add noise of equal strength at every octave, from a few metres down to one element."""
    import cv2

    size = 16
    noise: Any = random.standard_normal((size, size), dtype=np.float32)
    while size < count:
        size = min(2 * size, count)
        # The older octaves fade: patches of metres belong to the colours.
        noise = cv2.resize(noise * np.float32(_FADE), (size, size), interpolation=cv2.INTER_LINEAR)
        noise += random.standard_normal((size, size), dtype=np.float32)
    np.clip(noise, -4, 4, out=noise)
    return np.asarray(cv2.convertScaleAbs(noise, alpha=_CONTRAST, beta=MEAN_GREY), np.uint8)


def _scatter(detail: Bytes, texel_m: float, random: np.random.Generator) -> None:
    """Lay stones and tufts on the ground, and tracks of vehicles across it."""
    import cv2

    count = detail.shape[0]
    stones = int(_STONES_PER_M2 * (count * texel_m) ** 2)
    centres = random.integers(0, count * 16, (stones, 2))
    low, high = np.log(_STONE_M).tolist()
    radii = np.exp(random.uniform(low, high, stones)) / texel_m
    greys = np.clip(MEAN_GREY + random.choice([-1, 1], stones) * random.uniform(25, 75, stones), 30, 225)
    for centre, radius, grey in zip(centres.tolist(), radii.tolist(), greys.tolist(), strict=True):
        cv2.circle(detail, centre, max(round(radius * 16), 8), grey, -1, cv2.LINE_AA, 4)
    for _ in range(_TRACKS):
        ends = random.integers(0, count, (2, 2))
        middle = ends.mean(axis=0) + random.normal(0, count / 10, 2)
        share = np.linspace(0, 1, 60)[:, None]
        curve = (1 - share) ** 2 * ends[0] + 2 * share * (1 - share) * middle + share**2 * ends[1]
        width = max(round(0.25 / texel_m), 1)
        cv2.polylines(detail, [np.rint(curve).astype(np.int32)], False, 160, width, cv2.LINE_AA)


def _colour(terrain: Terrain, half_m: float, random: np.random.Generator) -> Bytes:
    import cv2

    count = int(np.ceil(2 * half_m / COLOUR_M))
    at = (np.arange(count) + 0.5) * COLOUR_M - half_m
    east, north = np.meshgrid(at, -at)
    heights = terrain.height(east.ravel(), north.ravel()).reshape(east.shape)
    fall, rise = np.gradient(heights, COLOUR_M)
    normal = np.stack([-rise, fall, np.ones_like(rise)], axis=-1)
    light = normal @ _SUN / np.linalg.norm(normal, axis=-1) / _SUN[2]
    coarse = random.standard_normal((14, 14))
    patches: Any = cv2.resize(coarse, (count, count), interpolation=cv2.INTER_CUBIC)
    grass = 1 / (1 + np.exp(-2.5 * patches))[..., None]
    colour = (grass * _GRASS + (1 - grass) * _SOIL) * np.clip(light, 0.5, 1.3)[..., None]
    return np.asarray(np.clip(colour, 0, 255), np.uint8)
