"""Lens models compared: each fitted to the same rays, and judged by images that did not take part."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork, fit, lowest, without_images
from photocal.adjustment.datum import with_datum
from photocal.adjustment.ledger import because
from photocal.adjustment.mounting import NO_ATTITUDES, NO_POSITIONS
from photocal.adjustment.near import Removals
from photocal.adjustment.network import NO_RELATIONS, Network
from photocal.adjustment.normal import normal_equations, prepare
from photocal.adjustment.removed import NEAR, state_without
from photocal.adjustment.solver import moved_by, reduced_step
from photocal.adjustment.state import State
from photocal.analysis.left_out import Checks
from photocal.base.arrays import Flags, Integers
from photocal.base.errors import IllPosedError, InputMalformedError, NotConvergedError
from photocal.base.policy import policy
from photocal.findings.finding import Figure, Finding, Size
from photocal.geometry.camera import MODELS, PARAMETERS, Camera, Model, among
from photocal.geometry.conversion import converted

# A model is better from here on: by how much it lowers v'Pv for each unknown more, and the residuals of the
# images that were left out. The same lens written otherwise differs by less.
GAIN, SHARE = 20.0, 0.01
# One step foretells a minimum that it does not quite reach: a lens is tried from this share of the gain on.
_PROMISING = 0.5


@dataclass(frozen=True)
class LensFit:
    """One model of the lens of a camera, all others unchanged.

    terms: its estimated coefficients.
    chi_squared: v'Pv of the whole network; of a lens that one step shows to be no better, as that foretells.
    left_out: root mean square of the standardised residuals of images that were left out, oriented on the
        points and with the lens of the others; NaN where no image could be, or the lens is no better.
    change_of_c: c with it less c as adjusted, in the unit of the camera: fisheyes have another; NaN likewise.
    check_rmse_m: of the check points in X, Y, Z.
    """

    model: Model
    terms: tuple[str, ...]
    chi_squared: float
    left_out: float
    change_of_c: float
    check_rmse_m: tuple[float, float, float] | None


def lens_fits(
    fitted: AdjustedNetwork, camera: int, checks: Checks, done: Callable[[], None]
) -> tuple[LensFit, ...]:
    """Fit every model to the rays of one camera; the one that it has comes first, then the better ones."""
    # Images are left out in so many groups of neighbours.
    most_groups = 6
    interior = fitted.network.cameras[camera].with_values(fitted.state.cameras[camera])
    if not set(interior.free) & set(interior.lens.terms) or interior.focus_m or interior.photo_variant:
        return ()
    images = np.flatnonzero(fitted.network.exposures.camera == camera)
    groups = [group for group in np.array_split(images, min(most_groups, len(images))) if len(group)]
    try:
        fits = [_judged(fitted, camera, interior, groups, checks)]
    except (IllPosedError, NotConvergedError):
        return ()
    for model in MODELS:
        try:
            cameras, values = list(fitted.network.cameras), fitted.state.cameras.copy()
            cameras[camera] = _alternative(interior, model)
            values[camera] = cameras[camera].values
            network = replace(fitted.network, cameras=tuple(cameras))
            # Terms of one name mean nearly the same in most models; where not, the converted ones are near.
            starts = (fitted.state, replace(fitted.state, cameras=values))
            each = [_foreseen(network, start) for start in starts]
            foreseen, start = min(each), starts[int(np.argmin(each))]
            if fitted.solution.chi_squared - foreseen < _PROMISING * GAIN:
                fits.append(_not_tried(cameras[camera], foreseen))
                continue
            with because(f"lens model {model}"):
                other = fit(network, start)
            fits.append(_judged(other, camera, interior, groups, checks, _nearby))
        except (IllPosedError, NotConvergedError, InputMalformedError):
            continue
        finally:
            done()
    return fits[0], *sorted(fits[1:], key=lambda lens: lens.chi_squared)


def _foreseen(network: Network, start: State) -> float:
    """Give v'Pv after one step, as the equations at its start tell it; infinite where they are singular."""
    problem = with_datum(prepare(network), start)
    normal = normal_equations(problem, start)
    step = reduced_step(problem, normal, 0.0)
    return np.inf if step is None else normal.chi_squared - moved_by(problem, start, normal, step)[1]


def _not_tried(alternative: Camera, foreseen: float) -> LensFit:
    """A lens that one step shows to be no better: its images are not left out."""
    nan = float("nan")
    return LensFit(alternative.model, _terms_of(alternative), foreseen, nan, nan, None)


def _terms_of(camera: Camera) -> tuple[str, ...]:
    return tuple(name for name in camera.free if name in camera.lens.terms)


def better_lens(fits: tuple[LensFit, ...]) -> LensFit | None:
    """Give the model that v'Pv and left-out images prefer to that of a camera; None when there is none."""
    if not fits:
        return None
    given = min((lens for lens in fits if lens.model == fits[0].model), key=lambda lens: lens.left_out)

    def gain(lens: LensFit) -> float:
        """By how much chi-squared falls beyond what the further terms of a lens must gain."""
        return given.chi_squared - lens.chi_squared - GAIN * max(len(lens.terms) - len(given.terms), 1)

    others = [lens for lens in fits if lens.model != given.model]
    better = [lens for lens in others if gain(lens) > 0 and lens.left_out < (1 - SHARE) * given.left_out]
    # Fewer coefficients win, and among as many the more usual model, where they predict as well.
    best = min((lens.left_out for lens in better), default=np.inf)
    alike = [lens for lens in better if lens.left_out < (1 + SHARE) * best]
    least = min((_akaike(lens) for lens in alike), default=np.inf)
    nearly = [lens for lens in alike if _akaike(lens) <= least + policy.alike_models]
    return min(nearly, key=lambda lens: list(MODELS).index(lens.model), default=None)


def _akaike(lens: LensFit) -> float:
    return lens.chi_squared + 2 * len(lens.terms)


def of_lenses(fitted: AdjustedNetwork, fits: tuple[tuple[LensFit, ...], ...]) -> list[Finding]:
    """Name the lenses that fit better than those that cameras have."""
    listed = []
    camera_of_ray = fitted.network.exposures.camera[fitted.network.rays.image]
    for k, (camera, of_camera) in enumerate(zip(fitted.network.cameras, fits, strict=True)):
        better = better_lens(of_camera)
        if better is None:
            continue
        px = float(np.median(fitted.network.rays.sigma[camera_of_ray == k])) / min(camera.pitch)
        figures: dict[str, Figure] = {
            "camera": camera.id,
            "model": better.model,
            "names": better.terms,
            "given": of_camera[0].left_out * px,
            "found": better.left_out * px,
            "fall": of_camera[0].chi_squared - better.chi_squared,
            "shift_c": better.change_of_c,
            "unit": camera.unit,
        }
        size = Size(better.left_out * px, "px", None, better.change_of_c, None, better.left_out * px)
        listed.append(Finding("lens-model", "doubtful", camera.id, figures, size=size))
    return listed


def _alternative(interior: Camera, model: Model) -> Camera:
    """The same lens as nearly as another model has it, its coefficients free."""
    affinity = interior.affinity if MODELS[model].relative == interior.lens.relative else None
    made = converted(interior, model, affinity or ("after" if MODELS[model].relative else "additive")).camera
    # A prism and powers beyond the fourth are asked for, never assumed.
    left = ("P3", "P4", "S1", "S2", "S3", "S4")
    terms = {name for name in MODELS[model].terms if name not in left}
    kept = {name for name in interior.free if name not in interior.lens.terms}
    prior = np.where(among("x0", "y0", "readout"), interior.prior_sigma, np.inf)
    return replace(made, estimated=among(*terms, *kept), prior_sigma=prior, prior_correlation=None)


def _nearby(removals: Removals, out: Flags) -> State:
    """Leave images out near the minimum: a lens that changes too much without them depends on them."""
    nearby = removals.without(out, NEAR)
    if nearby is None or not nearby.reached:
        raise NotConvergedError(f"the lens depends on {int(out.sum())} of {len(out)} images")
    return nearby.state


def _judged(
    fitted: AdjustedNetwork,
    camera: int,
    interior: Camera,
    groups: list[Integers],
    checks: Checks,
    without: Callable[[Removals, Flags], State] = state_without,
) -> LensFit:
    alternative = fitted.network.cameras[camera]
    squares, count = 0.0, 0
    removals = Removals(fitted.factored)
    for group in groups:
        out = np.isin(np.arange(len(fitted.network.image_names)), group)
        chi_squared, redundancy = _predicted(fitted, without(removals, out), out)
        squares, count = squares + chi_squared, count + redundancy
    rmse = checks.rmse(fitted.solution.points)
    return LensFit(
        alternative.model,
        _terms_of(alternative),
        fitted.solution.chi_squared,
        float(np.sqrt(squares / count)) if count > 0 else float("nan"),
        float(fitted.state.cameras[camera, 0]) - interior.value("c"),
        None if rmse is None else (float(rmse[0]), float(rmse[1]), float(rmse[2])),
    )


def _predicted(fitted: AdjustedNetwork, rest: State, out: Flags) -> tuple[float, int]:
    """V'Pv and redundancy of images oriented on the points, and with the lens, of all the others."""
    network, rays = fitted.network, fitted.network.rays
    known = np.bincount(rays.point[~out[rays.image]], minlength=len(network.point_names)) >= 2
    kept = out[rays.image] & known[rays.point]
    # An image tells its pose and something of the lens from this many rays on.
    fewest_rays = 12
    enough = np.bincount(rays.image[kept], minlength=len(out)) >= fewest_rays
    out = out & enough
    kept &= out[rays.image]
    if not kept.any():
        return 0.0, 0
    points = network.points
    held = replace(
        points,
        values=rest.points,
        held=np.ones_like(points.held),
        weight=np.zeros_like(points.weight),
    )
    by_rays = replace(
        network,
        cameras=tuple(
            replace(camera.with_values(values), estimated=np.zeros(len(PARAMETERS), dtype=np.bool_))
            for camera, values in zip(network.cameras, rest.cameras, strict=True)
        ),
        exposures=replace(network.exposures, sigma=np.full_like(network.exposures.sigma, np.inf)),
        points=held,
        rays=rays.rows(kept),
        relations=NO_RELATIONS,
        datum_points=None,
        positions=NO_POSITIONS,
        attitudes=NO_ATTITUDES,
        rig=network.rig.of_images(np.cumsum(out), np.zeros_like(out)),
        lasers=network.lasers.rows(slice(0)),
    )
    state = replace(fitted.state, cameras=rest.cameras, common=rest.common, points=rest.points)
    alone, state = without_images(by_rays, state, ~out)
    with because("images oriented on the points of all others"):
        chi_squared = lowest(alone, state, NEAR).chi_squared
    return chi_squared, 2 * int(kept.sum()) - 6 * int(out.sum())
