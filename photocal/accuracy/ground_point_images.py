"""Ground points that are measured in too few images to be control or check."""

from __future__ import annotations

from collections import Counter

from photocal.accuracy.findings import Finding
from photocal.accuracy.ground_points import name_list


def control_in_few_images(
    names: tuple[str, ...], observations: tuple[tuple[str, str], ...], role: str
) -> tuple[Finding, ...]:
    """Find ground points that are measured in one image only, or in none."""
    images = Counter(point for _, point in set(observations))
    one = [name for name in names if images[name] == 1]
    none = [name for name in names if images[name] == 0]
    said = []
    if one:
        cannot = (
            "holds the image in two directions, but a blunder in it cannot be found"
            if role == "control"
            else "cannot be intersected, so it checks nothing"
        )
        said.append(
            Finding(
                "one-image-only",
                f"{role} point {name_list(one)}: measured in one image only; such a point {cannot}. Measure "
                "it in at least "
                "three images.",
            )
        )
    if none:
        said.append(
            Finding("no-image", f"{role} point {name_list(none)}: measured in no image, it has no effect.")
        )
    return tuple(said)
