"""Pictures of calibrations: matrices of pairs, profiles of their distortion, vectors on the sensor.

Pictures of calibrations beside each other: parameters over the sets, principal points, profiles, pairs.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from photocal.analysis.estimates import estimates_of, without
from photocal.analysis.stability.comparison import CalibrationPair
from photocal.base.arrays import Floats
from photocal.base.files import output_picture
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import PARAMETERS, Camera, pixel_to_plane
from photocal.geometry.distortion import polynomial_distortion, radial_profile, radial_profile_sigma

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Arrows across the sensor; the longest one is this share of its width.
_ACROSS, _LONGEST = 13, 0.07
_RADIAL, _DECENTRING = slice(3, 7), slice(7, 11)
_DASHES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1)))


def displacements(camera: Camera, pixels: Floats) -> dict[str, Floats]:
    """What the distortion does to places of the image, right and down, px, each shape (n, 2).

    By the terms of the polynomial at those places, less the principal point: radial, decentring, and both
    together (Brown 1971). It is what the model adds to the projection; the affinity is left out.
    """
    plane = pixel_to_plane(camera.size_px, camera.pitch, pixels) - camera.values[1:3]
    shown = {}
    for name, left_out in (("radial", _DECENTRING), ("decentring", _RADIAL), ("total", slice(0, 0))):
        values = camera.values.copy()
        values[left_out] = 0.0
        moved = polynomial_distortion(camera.with_values(values), plane) / np.array(camera.pitch)
        shown[name] = moved * np.array([1.0, -1.0])
    return shown


def draw_curves(calibrations: tuple[Camera, ...], path: Path, say: Catalogue) -> None:
    """Draw the profiles of all calibrations, c, x0 and y0 over them, and vectors of the first and last."""
    with output_picture(path, (10.5, 9.5), font=10.0, dpi=130) as canvas:
        grid = canvas.add_gridspec(3, 12)
        radial, decentring = canvas.add_subplot(grid[0, :6]), canvas.add_subplot(grid[0, 6:])
        for k, calibration in enumerate(calibrations):
            _profiles(calibration, radial, decentring, _DASHES[k % len(_DASHES)])
        radial.set_title(say("drawn.radial"), fontsize=9)
        decentring.set_title(say("drawn.decentring"), fontsize=9)
        for axes in (radial, decentring):
            axes.set_xlabel(say("drawn.radius"), fontsize=8)
            axes.set_ylabel("px", fontsize=8)
            axes.axhline(0.0, color="#8a8f94", linewidth=0.6)
            axes.tick_params(labelsize=7)
        radial.legend(fontsize=7, frameon=False)
        for k, name in enumerate(("c", "x0", "y0")):
            _over_calibrations(calibrations, name, canvas.add_subplot(grid[1, 4 * k : 4 * k + 4]), say)
        first, last = calibrations[0], calibrations[-1]
        width, height = first.size_px
        steps = (np.arange(_ACROSS) + 0.5) / _ACROSS
        rows = (np.arange(round(_ACROSS * height / width)) + 0.5) / round(_ACROSS * height / width)
        pixels = np.column_stack([m.ravel() for m in np.meshgrid(steps * width, rows * height)]) - 0.5
        fields = displacements(first, pixels)
        change = displacements(last, pixels)["total"] - fields["total"]
        named = {say(f"drawn_of.{name}"): field for name, field in fields.items()}
        pictures = [(f"{name}, {first.id}", field) for name, field in named.items()]
        if len(calibrations) > 1:
            pictures.append((say("drawn.change", last=last.id, first=first.id), change))
        for k, (title, field) in enumerate(pictures):
            axes = canvas.add_subplot(grid[2, 3 * k : 3 * k + 3])
            _vectors(axes, first, pixels, field, title, say)


def _profiles(camera: Camera, radial: "Axes", decentring: "Axes", dashes: object) -> None:
    pitch = float(np.mean(camera.pitch))
    half = np.array(camera.size_px) * camera.pitch / 2.0
    radius = np.linspace(0.0, float(np.hypot(*(half + np.abs(camera.values[1:3])))), 200)
    curve = radial_profile(camera, radius) / pitch
    style = {"linestyle": dashes, "linewidth": 1.1, "label": camera.id}
    (line,) = radial.plot(radius / pitch, curve, **style)  # type: ignore[arg-type]
    spread = radial_profile_sigma(camera, radius) / pitch
    radial.fill_between(radius / pitch, curve - spread, curve + spread, color=line.get_color(), alpha=0.2)
    p1, p2, p3, p4 = camera.values[_DECENTRING]
    largest = 3.0 * np.hypot(p1, p2) * radius**2 * np.abs(1.0 + p3 * radius**2 + p4 * radius**4)
    decentring.plot(radius / pitch, largest / pitch, **style)  # type: ignore[arg-type]


def _over_calibrations(calibrations: tuple[Camera, ...], name: str, axes: "Axes", say: Catalogue) -> None:
    values, sigmas = [], []
    for camera in calibrations:
        pitch = float(np.mean(camera.pitch))
        values.append(camera.value(name) / pitch)
        sigmas.append(camera.sigma_of(name) / pitch)
    axes.errorbar(
        range(len(values)), values, yerr=sigmas, fmt="o-", color="#1a1a1a", linewidth=0.8, capsize=3
    )
    axes.set_xticks(
        range(len(values)), [calibration.id for calibration in calibrations], rotation=45, fontsize=7
    )
    axes.set_title(say("drawn.with_sigma", name=name), fontsize=9)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.tick_params(axis="y", labelsize=7)


def _vectors(axes: "Axes", camera: Camera, pixels: Floats, field: Floats, title: str, say: Catalogue) -> None:
    width, height = camera.size_px
    longest = max(float(np.linalg.norm(field, axis=1).max()), 1e-12)
    enlarged = _LONGEST * width / longest
    axes.quiver(*pixels.T, *(field * enlarged).T, angles="xy", scale_units="xy", scale=1.0, width=0.004)
    x, y = camera.values[1:3] / np.array(camera.pitch)
    axes.plot([width / 2.0 - 0.5 + x], [height / 2.0 - 0.5 - y], "+", color="#b03030", markersize=8)
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_title(f"{title}\n{say('drawn.longest', size=say.significant(longest, 3))}", fontsize=8)


def matrix_of(pairs: tuple[CalibrationPair, ...], names: tuple[str, ...], which: int) -> Floats:
    """Arrange one figure of every pair as a matrix."""
    place = {name: i for i, name in enumerate(names)}
    matrix = np.full((len(names), len(names)), np.nan)
    for pair in pairs:
        matrix[place[pair.second], place[pair.first]] = pair.figures[which].value_px
    return matrix


def draw(
    pairs: tuple[CalibrationPair, ...],
    names: tuple[str, ...],
    thresholds_px: Sequence[float],
    path: Path,
    say: Catalogue,
) -> None:
    """Draw the matrices of all methods, coloured by threshold.

    thresholds_px: limits between the colours, ascending, px.
    """
    from matplotlib.colors import BoundaryNorm, LinearSegmentedColormap

    kinds, of_pair = pairs[0].figures, {(pair.first, pair.second): pair for pair in pairs}
    columns = min(4, len(kinds))
    rows = -(-len(kinds) // columns)
    size = max(2.6, 0.42 * len(names) + 1.2)
    with output_picture(path, (size * columns, (size + 0.3) * rows), font=10.0, dpi=120) as canvas:
        largest = max(figure.value_px for pair in pairs for figure in pair.figures)
        bounds = [0.0, *thresholds_px, max(1.01 * largest, 1.01 * thresholds_px[-1])]
        norm = BoundaryNorm(bounds, 256)
        # Light colours, told apart by everyone, with black figures on them.
        colours = LinearSegmentedColormap.from_list("likeness", ["#9ecae1", "#fee391", "#fc9272"])
        for k, kind in enumerate(kinds):
            axes = canvas.add_subplot(rows, columns, k + 1)
            matrix = matrix_of(pairs, names, k)
            shown = axes.imshow(matrix, cmap=colours, norm=norm)
            for i, j in zip(*np.nonzero(np.isfinite(matrix)), strict=True):
                mark = "*" if of_pair[names[j], names[i]].figures[k].different else ""
                axes.text(j, i, f"{say.fixed(matrix[i, j], 2)}{mark}", ha="center", va="center", fontsize=7)
            axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
            axes.set_yticks(range(len(names)), names, fontsize=7)
            axes.set_title(f"{kind.method}: {say.stored(kind.definition)}", fontsize=8)
        canvas.colorbar(shown, ax=canvas.axes, shrink=0.8, label="px").set_ticks(bounds[:-1])
        canvas.suptitle(say("drawn.difference"), fontsize=9)


# The term whose part in the corrections is shown: the highest of the usual radial series.
_DROPPED = "K3"


def draw_parameters(
    calibrations: tuple[Camera, ...], pairs: tuple[CalibrationPair, ...], path: Path, say: Catalogue
) -> None:
    """Draw every estimated parameter with its standard deviation over the sets, and what they do.

    Besides: the principal points, radial profiles with K3 and without (the others following, as in an
    adjustment without it), affinity along the diagonal, radial and decentring together, and all pairs.
    """
    names = [n for n in PARAMETERS if any(camera.sigma_of(n) > 0.0 for camera in calibrations)]
    rows = -(-len(names) // 4)
    with output_picture(path, (11.0, 2.1 * rows + 8.0), font=8.0, dpi=120) as canvas:
        grid = canvas.add_gridspec(rows + 3, 12)
        for k, name in enumerate(names):
            row, column = divmod(k, 4)
            _over_sets(calibrations, name, canvas.add_subplot(grid[row, 3 * column : 3 * column + 3]))
        _principal_points(calibrations, canvas.add_subplot(grid[rows, :4]), say)
        _radial(calibrations, canvas.add_subplot(grid[rows, 4:8]), say, dropped=False)
        _radial(calibrations, canvas.add_subplot(grid[rows, 8:]), say, dropped=True)
        _affinity(calibrations, canvas.add_subplot(grid[rows + 1, :6]), say)
        _together(calibrations, canvas.add_subplot(grid[rows + 1, 6:]), say)
        _bars(pairs, canvas.add_subplot(grid[rows + 2, :]), say)


def without_term(camera: Camera, term: str) -> Camera:
    """Give a calibration as an adjustment without a term would: the others follow by their correlations."""
    known = estimates_of(camera)
    if known is None or term not in known.names:
        return camera.changed(**{term: 0.0})
    left = without(known, (term,))
    return camera.changed(**dict(zip(left.names, left.values.tolist(), strict=True)), **{term: 0.0})


def _over_sets(calibrations: tuple[Camera, ...], name: str, axes: "Axes") -> None:
    values = [camera.value(name) for camera in calibrations]
    sigmas = [camera.sigma_of(name) for camera in calibrations]
    axes.errorbar(range(len(values)), values, yerr=sigmas, fmt="o", color="#1a1a1a", markersize=3, capsize=2)
    axes.set_xticks(range(len(values)), [camera.id for camera in calibrations], fontsize=7)
    unit = f", {calibrations[0].unit}" if name in ("c", "x0", "y0") else ""
    axes.set_title(name + unit, loc="left")
    axes.tick_params(axis="y", labelsize=6)


def _principal_points(calibrations: tuple[Camera, ...], axes: "Axes", say: Catalogue) -> None:
    for camera in calibrations:
        pitch = np.array(camera.pitch)
        x, y = camera.values[1:3] / pitch
        axes.errorbar(
            x, y, camera.sigma_of("y0") / pitch[1], camera.sigma_of("x0") / pitch[0], "o", markersize=3
        )
        axes.annotate(camera.id, (x, y), textcoords="offset points", xytext=(3, 3), fontsize=7)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(say("drawn.principal_points"), loc="left")


def _radius(camera: Camera) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    half = np.array(camera.size_px) * camera.pitch / 2.0
    return np.linspace(0.0, float(np.hypot(*half)), 120)


def _radial(calibrations: tuple[Camera, ...], axes: "Axes", say: Catalogue, *, dropped: bool) -> None:
    for camera in calibrations:
        own = without_term(camera, _DROPPED) if dropped else camera
        radius, pitch = _radius(camera), float(np.mean(camera.pitch))
        axes.plot(radius / pitch, radial_profile(own, radius) / pitch, linewidth=1.0, label=camera.id)
    title = say("drawn.radial_without", term=_DROPPED) if dropped else say("drawn.radial_px")
    axes.set_title(title, loc="left")
    axes.set_xlabel(say("drawn.radius"))
    axes.legend(fontsize=6, frameon=False)


def _affinity(calibrations: tuple[Camera, ...], axes: "Axes", say: Catalogue) -> None:
    for camera in calibrations:
        radius, pitch = _radius(camera), float(np.mean(camera.pitch))
        size = np.hypot(camera.value("B1"), camera.value("B2")) * radius
        axes.plot(radius / pitch, size / pitch, linewidth=1.0, label=camera.id)
    axes.set_title(say("drawn.affinity"), loc="left")
    axes.set_xlabel(say("drawn.radius"))


def _together(calibrations: tuple[Camera, ...], axes: "Axes", say: Catalogue) -> None:
    for camera in calibrations:
        radius, pitch = _radius(camera), float(np.mean(camera.pitch))
        size = 3.0 * np.hypot(camera.value("P1"), camera.value("P2")) * radius**2
        axes.plot(radius / pitch, (np.abs(radial_profile(camera, radius)) + size) / pitch, linewidth=1.0)
    axes.set_title(say("drawn.together"), loc="left")
    axes.set_xlabel(say("drawn.radius"))


def _bars(pairs: tuple[CalibrationPair, ...], axes: "Axes", say: Catalogue) -> None:
    kinds = [f"{one.method}, {say.stored(one.definition)}" for one in pairs[0].figures]
    width = 0.8 / len(kinds)
    for k, kind in enumerate(kinds):
        values = [pair.figures[k].value_px for pair in pairs]
        axes.bar(np.arange(len(pairs)) + k * width - 0.4, values, width, label=kind)
    axes.set_yscale("log")
    axes.set_xticks(range(len(pairs)), [f"{p.first}-{p.second}" for p in pairs], rotation=60, fontsize=7)
    axes.set_title(say("drawn.pairs"), loc="left")
    axes.legend(fontsize=6, ncols=4, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0))
