"""Cameras compared pair by pair, as figures and as text.

One test that two calibrations are equal as parameter vectors, with their full covariances; and of many.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy.stats import chi2

from photocal.analysis.estimates import estimates_of
from photocal.analysis.stability.camera_file import CameraFile
from photocal.analysis.stability.comparison import (
    CalibrationPair,
    ComparisonFigure,
    Followed,
    compare,
    follow,
    likeness,
    sentences,
)
from photocal.analysis.stability.methods import (
    IdealImage,
    Method,
    fitted_pose,
    methods,
    rotation_misfit,
    sensor_grid,
    view,
)
from photocal.base.arrays import Floats, as_plain
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.policy import policy
from photocal.findings.texts import Catalogue, catalogue
from photocal.geometry.camera import PARAMETERS, Camera


@dataclass(frozen=True)
class ChiSquared:
    """A statistic against its distribution.

    p_value: probability of so large a statistic when all are the same camera.
    """

    chi_squared: float
    degrees_of_freedom: int
    p_value: float


@dataclass(frozen=True)
class EqualityTest:
    """Whether two calibrations, or all, are equal, all parameters in one test.

    parameters: estimated in one of both, or both; in all of them.
    vector: of the differences of the parameters, d' (S1 + S2)^-1 d; of the deviations from the mean vector,
        sum of (x - mean)' S^-1 (x - mean).
    image: the same of what they do in the image when the exterior orientation may turn the bundle back; only
        combinations that then move it count, as difference and as degree of freedom. None where the bundles
        cannot be compared.
    rms_px: what the difference, or the deviations, do there, root mean square, px.
    """

    parameters: tuple[str, ...]
    vector: ChiSquared
    image: ChiSquared | None
    rms_px: float | None


@dataclass(frozen=True)
class JointComparison:
    """Tests of every pair, by its names, and of all calibrations together; None for two."""

    pairs: dict[tuple[str, str], EqualityTest]
    together: EqualityTest | None


def joint_comparison(calibrations: Sequence[Camera], pixels: Floats) -> JointComparison:
    """Test every pair of calibrations, and all of them, for equality of their parameters.

    calibrations: independent of each other; those without standard deviations are left out.
    pixels (n, 2): column and row, px.
    """
    known = [camera for camera in calibrations if estimates_of(camera) is not None]
    pairs = {(a.id, b.id): _joint(a, b, pixels) for a, b in combinations(known, 2)}
    return JointComparison(pairs, _together(known, pixels) if len(known) > 2 else None)


def _names(cameras: Sequence[Camera]) -> tuple[str, ...]:
    return tuple(name for name in PARAMETERS if any(camera.sigma_of(name) > 0.0 for camera in cameras))


def _covariance(camera: Camera, names: Sequence[str]) -> Floats:
    """Covariance of parameters; of printed correlations the nearest that is none is made one."""
    sigma = np.array([camera.sigma_of(name) for name in names])
    eigenvalues, vectors = np.linalg.eigh(camera.correlation_of(names))
    correlation = (vectors * np.maximum(eigenvalues, 1e-9)) @ vectors.T
    return np.asarray(correlation * np.outer(sigma, sigma))


def _joint(first: Camera, second: Camera, pixels: Floats) -> EqualityTest:
    names = _names((first, second))
    d = np.array([second.value(name) - first.value(name) for name in names])
    both = _covariance(first, names) + _covariance(second, names)
    scale = np.sqrt(np.diag(both))
    root = np.linalg.cholesky(both / np.outer(scale, scale))
    z: Floats = np.asarray(np.linalg.solve(root, d / scale), dtype=np.float64)
    vector = _against(float(z @ z), len(names))
    factor: Floats = np.asarray(scale[:, None] * root, dtype=np.float64)
    image, rms_px = _in_image(first, second, names, factor, z, pixels)
    return EqualityTest(names, vector, image, rms_px)


def _in_image(
    first: Camera, second: Camera, names: Sequence[str], factor: Floats, z: Floats, pixels: Floats
) -> tuple[ChiSquared | None, float | None]:
    """Test what independent unit differences z do in the image beyond a rotation of the bundle."""
    values = dict(zip(PARAMETERS, (first.values + second.values) / 2.0, strict=True))
    seen = _visible(first.changed(**values), names, factor, pixels)
    if seen is None:
        return None, None
    directions, left = seen
    rms_px = float(np.linalg.norm(z @ left) / np.sqrt(len(pixels)))
    return _against(float(np.sum((directions.T @ z) ** 2)), directions.shape[1]), rms_px


def _visible(
    middle: Camera, names: Sequence[str], factor: Floats, pixels: Floats
) -> tuple[Floats, Floats] | None:
    """Tell which combinations of unit differences move the image when the bundle may turn back.

    factor (u, u): from unit differences to the parameters.
    returns directions (u, r), left (u, 2 n): what moves it, and by how much each unit moves it, px; None
        where the bundles cannot be compared.
    """
    rotation = Method("ROT", "two principal distances", "equations", 3, False, (rotation_misfit,))
    try:
        here = view(middle, pixels)
        _, design = fitted_pose(rotation, rotation_misfit, here, here)
        moved = np.array([_moved(middle, here, names, step, pixels) for step in factor.T])
    except (IllPosedError, NotConvergedError):
        return None
    basis, _ = np.linalg.qr(design)
    left = moved - (moved @ basis) @ basis.T
    directions, strength, _ = np.linalg.svd(left, full_matrices=False)
    # What moves the image by less than this with one standard deviation, px rms, is no difference in the
    # image.
    nothing_px = 0.02
    rank = int(np.sum(strength / np.sqrt(len(pixels)) > nothing_px))
    return np.asarray(directions[:, :rank]), np.asarray(left)


def _moved(camera: Camera, here: IdealImage, names: Sequence[str], step: Floats, pixels: Floats) -> Floats:
    """Change of the bundle, (2 n,) px, with a step of the parameters."""
    sides = []
    for sign in (1.0, -1.0):
        values = {name: camera.value(name) + sign * by for name, by in zip(names, step.tolist(), strict=True)}
        sides.append(rotation_misfit(here, view(camera.changed(**values), pixels), np.zeros(3)))
    return np.asarray((sides[0] - sides[1]).ravel() / 2.0)


def _together(cameras: Sequence[Camera], pixels: Floats) -> EqualityTest | None:
    """Test the deviations of all calibrations from their mean, as vectors and in the image."""
    names = tuple(n for n in PARAMETERS if all(camera.sigma_of(n) > 0.0 for camera in cameras))
    if not names:
        return None
    # In units of a difference of two of them; those units are independent of each other.
    covariances = [_covariance(camera, names) for camera in cameras]
    twice = 2.0 * np.mean(covariances, axis=0)
    scale = np.sqrt(np.diag(twice))
    factor = scale[:, None] * np.linalg.cholesky(twice / np.outer(scale, scale))
    inverse = np.linalg.inv(factor)
    units = [inverse @ np.array([camera.value(name) for name in names]) for camera in cameras]
    spreads = [inverse @ one @ inverse.T for one in covariances]
    whole, mean = _homogeneous(units, spreads)
    middle = cameras[0].changed(**dict(zip(names, (factor @ mean).tolist(), strict=True)))
    seen = _visible(middle, names, factor, pixels)
    if seen is None:
        return EqualityTest(names, whole, None, None)
    directions, left = seen
    moves = [float(np.sum(((unit - mean) @ left) ** 2)) for unit in units]
    rms_px = float(np.sqrt(np.mean(moves) / len(pixels)))
    if not directions.shape[1]:
        return EqualityTest(names, whole, _against(0.0, 0), rms_px)
    along = [directions.T @ unit for unit in units]
    image, _ = _homogeneous(along, [directions.T @ one @ directions for one in spreads])
    return EqualityTest(names, whole, image, rms_px)


def _homogeneous(vectors: Sequence[Floats], covariances: Sequence[Floats]) -> tuple[ChiSquared, Floats]:
    """Test vectors for one common mean, which is given, too."""
    weights = [np.linalg.inv(one) for one in covariances]
    right = np.sum([w @ x for w, x in zip(weights, vectors, strict=True)], axis=0)
    mean = np.linalg.solve(np.sum(weights, axis=0), right)
    total = sum(float((x - mean) @ w @ (x - mean)) for w, x in zip(weights, vectors, strict=True))
    return _against(total, (len(vectors) - 1) * len(mean)), mean


def _against(statistic: float, freedom: int) -> ChiSquared:
    return ChiSquared(statistic, freedom, float(chi2.sf(statistic, freedom)))


def joint_text(joint: JointComparison, level: float, say: Catalogue) -> str:
    """Write the tests for people; those whose probability is below the level are marked."""
    from photocal.findings.document import Section, table, text

    rows = []
    for (first, second), one in joint.pairs.items():
        moved = "-" if one.rms_px is None else say.row([one.rms_px], ".2f")
        cells = (*_cells(one.vector, level, say), *_cells(one.image, level, say))
        rows.append((f"{first}-{second}", *cells, moved))
    heads, note = say("compared.vectors_heads").split("|"), say("compared.vectors_note")
    made = [text([Section("", (table(say("compared.vectors"), heads, rows, note),))])] if rows else []
    if joint.together is not None:
        chi, of, p = _cells(joint.together.vector, level, say)
        told = say("compared.together", chi=chi, of=of, p=p.strip())
        if joint.together.image is not None:
            chi, of, p = _cells(joint.together.image, level, say)
            rms = joint.together.rms_px
            told += say.told("compared.together_image", chi=chi, of=of, p=p.strip(), rms=rms)
        made.append(told)
    return "\n".join(made)


def _cells(test: ChiSquared | None, level: float, say: Catalogue) -> tuple[str, str, str]:
    if test is None:
        return ("-", "", "")
    mark = "*" if test.p_value < level else " "
    chi, p = say.row([test.chi_squared], ".1f"), say.row([test.p_value], ".3g")
    return chi, str(test.degrees_of_freedom), f"{p}{mark}"


SCHEMA = "photocal.comparison/1"


@dataclass(frozen=True)
class Compared:
    """Every pair of some calibrations, compared by all methods.

    Attributes
    ----------
    asked
        The calibrations, and how they are compared.
    points
        Number of image points at which they are compared.
    pairs
        Misclosure, zero rotation, rotation and single photo resection of each pair, px.
    followed
        Published figures, and whether the computed ones agree with them.
    joint
        Every pair, and all, tested for equality of their parameters as vectors.
    """

    asked: CameraFile
    points: int
    pairs: tuple[CalibrationPair, ...]
    followed: tuple[Followed, ...]
    joint: JointComparison

    def figures(self) -> dict[str, Any]:
        """Give all figures as a JSON value."""
        made = _figures(self.asked, self.points, self.pairs, self.followed)
        pairs = [{"first": a, "second": b, **as_plain(test)} for (a, b), test in self.joint.pairs.items()]
        return made | {"joint": {"pairs": pairs, "together": as_plain(self.joint.together)}}

    def __repr__(self) -> str:
        """Say it for people: a matrix for each method, then what differs."""
        return self.text(catalogue("en"))

    def text(self, say: Catalogue) -> str:
        """Give it as a text in a language."""
        level = 1.0 - policy.confidence
        told = (_text(self.asked, self.pairs, self.followed, say), joint_text(self.joint, level, say))
        return "\n\n".join(filter(None, told))


def compare_cameras(asked: CameraFile, done: Callable[[], None] = lambda: None) -> Compared:
    """Compare every pair of calibrations.

    Parameters
    ----------
    asked
        Calibrations, and grid, terrains and seed of the comparison.
    done
        Called after each pair.

    Returns
    -------
    Compared
        All pairs, and what differs beyond the noise of both.

    Raises
    ------
    ConfigurationError
        When the calibrations are of formats that cannot be compared.
    """
    how = asked.comparison
    pixels = sensor_grid(asked.calibrations[0].size_px, how.grid_step_px)
    chosen = methods(len(pixels), how.terrain, how.terrains_each, how.seed)
    pairs = compare(asked.calibrations, pixels, chosen, np.random.default_rng(how.seed), done=done)
    joint = joint_comparison(asked.calibrations, pixels)
    return Compared(asked, len(pixels), pairs, follow(asked.published, pairs), joint)


def _figures(
    asked: CameraFile, points: int, pairs: tuple[CalibrationPair, ...], followed: tuple[Followed, ...]
) -> dict[str, Any]:
    how = asked.comparison
    return {
        "schema": SCHEMA,
        "cameras": [calibration.id for calibration in asked.calibrations],
        "grid": {"points": points, "step_px": how.grid_step_px},
        "thresholds_px": how.thresholds_px,
        "terrains": [terrain.model_dump() for terrain in how.terrain],
        "terrains_each": how.terrains_each,
        "seed": how.seed,
        "pairs": [
            {
                "first": pair.first,
                "second": pair.second,
                "figures": [
                    as_plain(figure)
                    | {"different": figure.different, "within_px": likeness(figure, how.thresholds_px)}
                    for figure in pair.figures
                ],
            }
            for pair in pairs
        ],
        "published": [as_plain(row) | {"follows": row.follows} for row in followed],
        "findings": list(sentences(pairs, how.thresholds_px, followed, catalogue("en"))),
    }


def _text(
    asked: CameraFile,
    pairs: tuple[CalibrationPair, ...],
    followed: tuple[Followed, ...],
    say: Catalogue,
) -> str:
    names = tuple(calibration.id for calibration in asked.calibrations)
    blocks = [_matrix(pairs, names, k, say) for k in range(len(pairs[0].figures))]
    if any(figure.sigma_px is not None for pair in pairs for figure in pair.figures):
        blocks.append(say("compared.sigmas"))
    told = sentences(pairs, asked.comparison.thresholds_px, followed, say)
    return "\n\n".join([*blocks, "\n".join(told)])


def _matrix(pairs: tuple[CalibrationPair, ...], names: tuple[str, ...], which: int, say: Catalogue) -> str:
    from photocal.findings.document import Section, table, text

    cells = {(pair.first, pair.second): _cell(pair.figures[which], say) for pair in pairs}
    kind = pairs[0].figures[which]
    rows = [(second, *(cells.get((first, second), "") for first in names[:-1])) for second in names[1:]]
    title = say("compared.matrix", method=kind.method, definition=say.stored(kind.definition))
    return text([Section("", (table(title, ["", *names[:-1]], rows),))])


def _cell(figure: ComparisonFigure, say: Catalogue) -> str:
    if figure.sigma_px is None:
        return f"{say.row([figure.value_px], '.2f')} "
    both = say.row([figure.value_px, figure.sigma_px], ".2f", "+-")
    return f"{both}{'*' if figure.different else ' '}"
