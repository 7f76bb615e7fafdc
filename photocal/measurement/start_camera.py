"""Cameras to start from: one for each kind of image, the principal distance from the EXIF."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import Integers
from photocal.geometry.camera import Camera, camera
from photocal.measurement.image_facts import ImageFacts

# A "35 mm equivalent" is stated for a frame 36 mm wide (makers take the width: CIPA DCG-001 takes the
# diagonal, which agrees for frames of 3 : 2).
FRAME_WIDTH_MM = 36.0
# Tags that give less or more than these shares of the longer side, or are unlike the equivalent by this
# logarithm, are wrong. Where nothing is known: a field of view of 60 degrees along the longer side.
LEAST_WIDTHS, MOST_WIDTHS, UNLIKE = 0.2, 50.0, 0.25
UNKNOWN_WIDTHS = 1 / (2 * math.tan(math.radians(30)))


def group_cameras(facts: Sequence[ImageFacts]) -> tuple[tuple[str, ...], Integers]:
    """Tell which images were taken by the same camera with the same lens."""
    keys: dict[tuple[object, ...], int] = {}
    names: list[str] = []
    members = np.zeros(len(facts), dtype=np.int64)
    for k, image in enumerate(facts):
        focal = -1.0 if math.isnan(image.focal_mm) else image.focal_mm
        band = image.maker_camera.get("RigCameraIndex", "")
        key = (image.make, image.model, image.serial, focal, image.size_px, band)
        if key not in keys:
            keys[key] = len(keys)
            plain = re.sub(r"[^A-Za-z0-9]+", "-", image.model or image.make or "camera").strip("-").lower()
            name = plain or "camera"
            names.append(name if name not in names else f"{name}-{len(names) + 1}")
        members[k] = keys[key]
    return tuple(names), members


@dataclass(frozen=True)
class GivenLens:
    """What a person says of the lens in place of what pictures state; 0 where nothing is said."""

    c_px: float = 0.0
    focal_mm: float = 0.0

    def of(self, facts: ImageFacts) -> ImageFacts:
        """Give what an image states, with what the person says."""
        if self.c_px > 0:
            return replace(facts, c_px=self.c_px, maker_camera={})
        if self.focal_mm > 0:
            longer = facts.focal_35mm * self.focal_mm / facts.focal_mm
            return replace(facts, focal_mm=self.focal_mm, focal_35mm=longer, maker_camera={})
        return facts


NO_LENS = GivenLens()


def principal_distance_px(facts: ImageFacts) -> tuple[float, str]:
    """Principal distance to start from."""
    longer = max(facts.size_px)
    if math.isfinite(facts.c_px):
        return facts.c_px, "given"
    tags, equivalent = facts.focal_mm / facts.pitch_mm, longer * facts.focal_35mm / FRAME_WIDTH_MM
    # Tags of pictures that were made smaller may be of the larger ones.
    believed = LEAST_WIDTHS < tags / longer < MOST_WIDTHS and not abs(math.log(tags / equivalent)) > UNLIKE
    if believed:
        return tags, "EXIF focal length and FocalPlane tags"
    if math.isfinite(facts.focal_35mm) and 5 <= facts.focal_35mm <= 2000:
        return equivalent, "EXIF focal length, 35 mm equivalent"
    return longer * UNKNOWN_WIDTHS, "assumed (60 degrees along the longer side)"


def start_camera(name: str, facts: ImageFacts, c: float, estimate: tuple[str, ...]) -> Camera:
    """Make a camera in px that is estimated on the job."""
    return camera(
        name,
        "brown-ideal",
        "px",
        facts.size_px,
        (1.0, 1.0),
        {"c": c},
        estimate=estimate,
        affinity="after",
    )
