"""Why a picture does not belong: what shows in it, and what it says of itself, beside those that do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from drivers.arrays import Bytes
from drivers.errors import PhotocalError
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.image_file import as_eight_bit, read_grey

# Shares of a picture that are white or black, of which nothing can be seen; and its sharpness beside that of
# the others when it is blurred.
WHITE, BLACK, BURNT = 250, 5, 0.4
BLURRED = 0.4
# Pictures that sharpness is compared with.
OTHERS = 3


def explained(
    left_out: Iterable[Mapping[str, str]], paths: Mapping[str, Path], facts: Sequence[ImageFacts]
) -> list[dict[str, str]]:
    """Reasons with what the picture itself has to do with them."""
    entries = [dict(entry) for entry in left_out]
    gone = {entry["image"] for entry in entries}
    of_image = {own.name: own for own in facts}
    cameras = Counter(_camera(own) for own in facts if own.name not in gone)
    usual = cameras.most_common(1)[0][0] if cameras else ""
    others = [path for name, path in paths.items() if name not in gone] if gone & set(paths) else []
    pictures = [grey for path in others[:OTHERS] if (grey := _read(path)) is not None]
    sharp = [_sharpness(grey) for grey in pictures]
    for entry in entries:
        own, path = of_image.get(entry["image"]), paths.get(entry["image"])
        if own is None or path is None:
            continue
        also = [f"taken by another camera ({_camera(own)})"] if usual and _camera(own) != usual else []
        also += _appearance(_read(path), sharp)
        entry["reason"] = "; ".join([entry["reason"], *also])
    return entries


def _camera(own: ImageFacts) -> str:
    width, height = own.size_px
    return " ".join(part for part in (own.model or own.make, f"{width} x {height} px") if part)


def _read(path: Path) -> Bytes | None:
    try:
        return as_eight_bit(read_grey(path))
    except PhotocalError:
        return None


def _appearance(grey: Bytes | None, sharp: Sequence[float]) -> list[str]:
    if grey is None:
        return []
    white, black = float(np.mean(grey >= WHITE)), float(np.mean(grey <= BLACK))
    if white > BURNT:
        return [f"over-exposed: {white:.0%} of it is white"]
    if black > BURNT:
        return [f"under-exposed: {black:.0%} of it is black"]
    if len(sharp) == OTHERS and _sharpness(grey) < BLURRED * float(np.median(sharp)):
        return ["blurred"]
    return []


def _sharpness(grey: Bytes) -> float:
    """Finest detail over all contrast."""
    import cv2

    fine = cv2.Laplacian(cv2.GaussianBlur(grey, (0, 0), 1.0), cv2.CV_32F)
    return float(fine.std() / max(float(grey.std()), 1.0))
