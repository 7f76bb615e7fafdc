"""Findings about groups of observations: image axes, cameras, images, places on the sensor."""

from __future__ import annotations

import numpy as np

from photocal.analysis.hidden.finding import SMALL_PX, Finding
from photocal.analysis.hidden.search import LEVEL, Search
from photocal.analysis.hidden.variance_components import VarianceComponent

# An image's own scale or principal point is listed when it moves a ray beyond the noise of single ones.
VISIBLE_SIGMAS = 2.5
# Scatter against that of all together: from here on an axis or camera is listed, and no longer called small.
WORTH_A_LINE = 1.05
SMALL_RATIO = 1.25


def of_groups(search: Search) -> list[Finding]:
    """Describe image axes and cameras that scatter differently.

    Parameters
    ----------
    search : Search
        What was found.

    Returns
    -------
    list of Finding
        No line, or one for each that is concerned.
    """
    listed = []
    overall = search.sigma.found / search.sigma.assumed
    for what, components in (("image axis", search.axes), ("camera", search.cameras)):
        listed += [
            _scatter(f"{what} {one.name}", "variance-component", one, search)
            for one in components
            if one.p_value < LEVEL and one.ratio > WORTH_A_LINE * overall
        ]
    return listed


def of_images(search: Search) -> list[Finding]:
    """Describe images that scatter more, or have a scale or principal point of their own.

    Parameters
    ----------
    search : Search
        What was found.

    Returns
    -------
    list of Finding
        No line, or one for each that is concerned.
    """
    components = {one.name: one for one in search.images}
    sigma_px = search.sigma.found / min(search.last.network.cameras[0].pitch)
    overall = search.sigma.found / search.sigma.assumed
    listed = []
    shifts = {one.image: one for one in search.shifts}
    for name, component in components.items():
        shift = shifts.get(name)
        shifted = shift is not None and shift.p_value < LEVEL and shift.effect_px > VISIBLE_SIGMAS * sigma_px
        # One bad image makes the good ones look better than all together: only the bad one is named.
        scattered = component.p_value < LEVEL and component.ratio > overall
        if not (scattered or shifted):
            continue
        found = _scatter(f"image {name}", "image", component, search)
        if shift is None or not shifted:
            listed.append(found)
            continue
        small = shift.effect_px < SMALL_PX
        sentence = (
            f"{found.sentence.split(':')[0]}, with a scale or principal point of its own that moves "
            f"rays by up to {shift.effect_px:.2f} px{': small' if small else ''}."
        )
        listed.append(Finding("image", sentence, found.figure, None, "1", None, None, shift.effect_px, small))
    return sorted(listed, key=lambda one: -one.figure)


def _scatter(name: str, kind: str, one: VarianceComponent, search: Search) -> Finding:
    relative = one.ratio / (search.sigma.found / search.sigma.assumed)
    effect = one.ratio * search.sigma.assumed / min(search.last.network.cameras[0].pitch)
    small = effect < SMALL_PX or relative < SMALL_RATIO
    label = name[0].upper() + name[1:]
    sentence = f"{label} scatters {relative:.1f} times as much as all together ({effect:.2f} px)"
    return Finding(
        kind, f"{sentence}{': small' if small else ''}.", relative, None, "1", None, None, effect, small
    )


def of_maps(search: Search) -> list[Finding]:
    """Describe patterns of the residuals on the sensor.

    Parameters
    ----------
    search : Search
        What was found.

    Returns
    -------
    list of Finding
        No line, or one for each that is concerned.
    """
    listed = []
    for camera, cells in zip(search.last.network.cameras, search.maps, strict=True):
        if cells is None or (cells.global_p_value >= LEVEL and not cells.significant.any()):
            continue
        length = np.linalg.norm(cells.mean_px, axis=-1)
        length[cells.count == 0] = 0.0
        if cells.significant.any():
            length[~cells.significant] = 0.0
        row, column = np.unravel_index(int(np.argmax(length)), length.shape)
        effect = float(length[row, column])
        small = effect < SMALL_PX
        sentence = (
            f"Camera {camera.id}: residuals keep a pattern on the sensor, {int(cells.significant.sum())} "
            f"of {cells.cells} cells significant, largest mean {effect:.2f} px near column "
            f"{(cells.columns_px[column] + cells.columns_px[column + 1]) / 2:.0f}, row "
            f"{(cells.rows_px[row] + cells.rows_px[row + 1]) / 2:.0f}{': small' if small else ''}."
        )
        listed.append(Finding("residual-map", sentence, effect, None, "px", None, None, effect, small))
    return listed
