"""Smear of an image by the motion of the camera while its shutter is open."""

from typing import TypeVar

from photocal.base.arrays import Floats

Figure = TypeVar("Figure", float, Floats)

# Half a pixel of smear halves the contrast of the finest detail.
SMEAR_LIMIT_PX = 0.5


def smear_px(exposure_s: Figure, ground_speed_m_s: Figure, gsd_m: Figure) -> Figure:
    """Give the smear of the image by the motion during the exposure."""
    return exposure_s * ground_speed_m_s / gsd_m
