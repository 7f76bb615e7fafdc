"""Every pair of calibrations by every method, with the uncertainty of each figure and what it means."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from pydantic import FiniteFloat, PositiveFloat

from photocal.analysis.stability import methods
from photocal.analysis.stability.methods import IdealImage, Method, Misfit
from photocal.base.arrays import Floats
from photocal.base.checked_toml import Table
from photocal.base.errors import ConfigurationError
from photocal.base.policy import policy
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import Camera

Wobble = tuple[IdealImage, ...]


@dataclass(frozen=True)
class ComparisonFigure:
    """How much two calibrations differ, by one method.

    sigma_px: its standard deviation from the covariances of both calibrations.
    noise_px: what it stays below in 95 of 100 cases when both are the same camera.
    p_value: probability of so large a figure when both are the same camera.
    """

    method: str
    definition: str
    source: str
    value_px: float
    sigma_px: float | None
    noise_px: float | None
    p_value: float | None

    @property
    def different(self) -> bool | None:
        """Whether the calibrations differ beyond their noise; None when the noise is unknown."""
        return None if self.noise_px is None else self.value_px > self.noise_px


@dataclass(frozen=True)
class CalibrationPair:
    """All figures of one pair of calibrations."""

    first: str
    second: str
    figures: tuple[ComparisonFigure, ...]


def compare(
    calibrations: tuple[Camera, ...],
    pixels: Floats,
    chosen: tuple[Method, ...],
    generator: np.random.Generator,
    draws: int = 1000,
    done: Callable[[], None] = lambda: None,
) -> tuple[CalibrationPair, ...]:
    """Compare every pair of calibrations; set I is the one that comes first.

    pixels (n, 2): the grid, column and row, px.
    raises ConfigurationError: when there is only one calibration, a name occurs twice, or formats differ.
    raises NotConvergedError: when two bundles cannot be brought together.
    """
    _check(calibrations)
    views = {calibration.id: methods.view(calibration, pixels) for calibration in calibrations}
    wobbles = {calibration.id: methods.wobble(calibration, pixels) for calibration in calibrations}
    pairs = []
    for a, b in combinations(calibrations, 2):
        figures = tuple(
            _figure(method, views[a.id], views[b.id], wobbles[a.id], wobbles[b.id], generator, draws)
            for method in chosen
        )
        pairs.append(CalibrationPair(a.id, b.id, figures))
        done()
    return tuple(pairs)


def _figure(
    method: Method,
    first: IdealImage,
    second: IdealImage,
    first_wobble: Wobble | None,
    second_wobble: Wobble | None,
    generator: np.random.Generator,
    draws: int,
) -> ComparisonFigure:
    poses = [methods.fitted_pose(method, misfit, first, second) for misfit in method.misfits]
    values = [
        float(methods.figure(method, misfit(first, second, pose)))
        for misfit, (pose, _) in zip(method.misfits, poses, strict=True)
    ]
    value, named = float(np.mean(values)), (method.name, method.definition, method.source)
    if first_wobble is None or second_wobble is None:
        return ComparisonFigure(*named, value, None, None, None)
    z = generator.standard_normal((draws, len(first_wobble) + len(second_wobble)))
    around, noise = np.zeros(draws), np.zeros(draws)
    for misfit, (pose, design) in zip(method.misfits, poses, strict=True):
        field = misfit(first, second, pose)
        change = _after_fit(_changes(misfit, first, second, first_wobble, second_wobble, pose), design)
        noise += _drawn(method, np.zeros_like(field), change, z) / len(poses)
        around += _drawn(method, field, change, z) / len(poses)
    p_value = float((1 + np.sum(noise >= value)) / (1 + draws))
    return ComparisonFigure(
        *named, value, float(np.std(around)), float(np.quantile(noise, policy.confidence)), p_value
    )


def _drawn(method: Method, field: Floats, change: Floats, z: Floats) -> Floats:
    """Give the figure of field + z change for every row of z."""
    if method.mean_distance:
        parts = np.array_split(z, max(1, len(z) // 250))
        fields = (field + np.tensordot(part, change, axes=1) for part in parts)
        return np.concatenate([methods.figure(method, drawn) for drawn in fields])
    # A sum of squares needs only the products of the changes, not the grid for every draw.
    flat = change.reshape(len(change), -1)
    products, along, start = flat @ flat.T, flat @ field.ravel(), float(np.sum(field**2))
    squares = start + 2.0 * z @ along + np.einsum("di,ij,dj->d", z, products, z)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) / methods.redundancy(method, len(field))))


def _changes(
    misfit: Misfit,
    first: IdealImage,
    second: IdealImage,
    first_wobble: Wobble,
    second_wobble: Wobble,
    pose: Floats,
) -> Floats:
    """Give the change of the misfit, (p, n, 2) px, for each unit normal variable, at a fixed pose."""

    def moved(view: IdealImage, by: IdealImage, sign: float) -> IdealImage:
        """A view displaced by one standard deviation of its calibration, forwards or backwards."""
        return IdealImage(view.ideal + sign * by.ideal, view.c + sign * by.c)

    of_first = [
        (misfit(moved(first, by, 1.0), second, pose) - misfit(moved(first, by, -1.0), second, pose)) / 2.0
        for by in first_wobble
    ]
    of_second = [
        (misfit(first, moved(second, by, 1.0), pose) - misfit(first, moved(second, by, -1.0), pose)) / 2.0
        for by in second_wobble
    ]
    return np.array(of_first + of_second)


def _after_fit(changes: Floats, design: Floats) -> Floats:
    """Take away what the pose follows: only the rest remains in the misfit."""
    if design.shape[1] == 0:
        return changes
    basis, _ = np.linalg.qr(design)
    flat = changes.reshape(len(changes), -1)
    return np.asarray((flat - (flat @ basis) @ basis.T).reshape(changes.shape))


def _check(calibrations: tuple[Camera, ...]) -> None:
    if len(calibrations) < 2:
        raise ConfigurationError(
            f"{len(calibrations)} calibration cannot be compared", "give two or more [[camera]] entries"
        )
    names = [calibration.id for calibration in calibrations]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ConfigurationError(f"camera {twice[0]} occurs twice", "give each calibration its own id")
    size = calibrations[0].size_px
    for calibration in calibrations[1:]:
        if calibration.size_px != size:
            raise ConfigurationError(
                f"camera {calibration.id} has {calibration.size_px[0]} x {calibration.size_px[1]} px, "
                f"camera {names[0]} has {size[0]} x {size[1]} px",
                "compare calibrations of one image format",
            )


class Published(Table):
    """Figures printed elsewhere, by one method: the names of both calibrations, and the figure, px.

    tolerance_px: how far a recomputed figure may be from the printed one.
    """

    method: Literal["MIS", "ZROT", "ROT", "SPR"]
    definition: str
    tolerance_px: PositiveFloat
    values: list[tuple[str, str, FiniteFloat]]


@dataclass(frozen=True)
class Followed:
    """A figure printed elsewhere for a pair of calibrations, and the one that their parameters give."""

    method: str
    definition: str
    first: str
    second: str
    printed_px: float
    tolerance_px: float
    computed_px: float

    @property
    def follows(self) -> bool:
        """Whether both agree within the tolerance."""
        return abs(self.computed_px - self.printed_px) <= self.tolerance_px


def follow(published: tuple[Published, ...], pairs: tuple[CalibrationPair, ...]) -> tuple[Followed, ...]:
    """Set printed figures against those of the comparison."""
    computed = {
        (figure.method, figure.definition, pair.first, pair.second): figure.value_px
        for pair in pairs
        for figure in pair.figures
    }
    return tuple(
        Followed(*key, value, printed.tolerance_px, computed[key])
        for printed in published
        for first, second, value in printed.values
        if (key := (printed.method, printed.definition, first, second)) in computed
    )


def likeness(figure: ComparisonFigure, thresholds_px: Sequence[float]) -> float | None:
    """Give the tightest threshold that a figure keeps.

    thresholds_px: thresholds, px.
    returns: the threshold; None when the figure exceeds them all.
    """
    return min((limit for limit in thresholds_px if figure.value_px <= limit), default=None)


def sentences(
    pairs: tuple[CalibrationPair, ...],
    thresholds_px: Sequence[float],
    followed: tuple[Followed, ...],
    say: Catalogue,
) -> tuple[str, ...]:
    """Put a comparison into words.

    thresholds_px: thresholds, px.
    """
    loosest = max(thresholds_px)
    texts = []
    for k, kind in enumerate(pairs[0].figures):
        figures = [pair.figures[k] for pair in pairs]
        alike = sum(figure.value_px <= loosest for figure in figures)
        beyond = [figure.different for figure in figures if figure.different is not None]
        noise = say("compared.noise", n=sum(beyond), all=len(beyond)) if beyond else ""
        worst = max(range(len(pairs)), key=lambda i: figures[i].value_px)
        of = {"method": kind.method, "definition": say.stored(kind.definition)}
        pair = {"first": pairs[worst].first, "second": pairs[worst].second}
        sizes = {"limit": float(loosest), "worst": figures[worst].value_px}
        texts.append(
            say.told("compared.kind", **of, **pair, **sizes, alike=alike, pairs=len(pairs), noise=noise)
        )
    for row in followed:
        if not row.follows:
            of = {"method": row.method, "definition": say.stored(row.definition)}
            pair = {"first": row.first, "second": row.second}
            sizes = {"printed": row.printed_px, "computed": row.computed_px}
            texts.append(say.told("compared.published", **of, **pair, **sizes))
    return tuple(texts)
