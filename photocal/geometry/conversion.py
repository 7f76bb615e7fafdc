"""From one camera model to another: exactly where they agree, else by a fit whose residual is stated."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import InputMalformedError
from photocal.geometry.camera import MODELS, PARAMETERS, Affinity, Camera, Model
from photocal.geometry.distortion import affinity_matrix, distorted, undistorted

_K, _P, _B, _READOUT = slice(3, 7), slice(7, 11), slice(11, 13), PARAMETERS.index("readout")


@dataclass(frozen=True)
class Conversion:
    """A camera in another model.

    rms_px, largest_px: distance between the image points of the same ray in both models, over the whole
        image; 0 when the models are the same.
    """

    camera: Camera
    rms_px: float = 0.0
    largest_px: float = 0.0


def in_pixels(camera: Camera) -> Camera:
    """Express a camera in px."""
    if camera.unit == "px":
        return camera
    width, height = camera.pitch
    stretch, powers = height / width, camera.lens.powers()
    values = camera.values * (1 / height) ** powers
    affinity = camera.affinity
    if abs(stretch - 1) > 1e-12:
        if not camera.values[_B].any():
            affinity = "before" if camera.model == "brown-observed" else "after"
        possible = "before" if camera.model == "brown-observed" else "after"
        if affinity != possible or camera.affinity_form != "fraser":
            raise InputMalformedError(
                f"camera {camera.id} has pixels that are not square and an affinity that acts elsewhere",
                "use square pixels",
            )
        values[1] *= stretch
        if possible == "after":
            values[_B] = [stretch * (1 + values[11]) - 1, stretch * values[12]]
        else:
            values[11] = (1 + values[11]) / stretch - 1
    return replace(
        camera,
        unit="px",
        pitch=(1.0, 1.0),
        values=values,
        prior_sigma=camera.prior_sigma * (1 / height) ** powers,
        reference_radius=camera.reference_radius / height,
        affinity=affinity,
    )


def unbalanced(camera: Camera) -> Camera:
    """Turn balanced radial distortion (R0 > 0) into the plain polynomial: the same camera with another c.

    The constant part s = K1 R0^2 + K2 R0^4 + ... scales the image and goes into the principal distance.
    """
    if camera.reference_radius == 0:
        return camera
    values = camera.values.copy()
    s = float(values[_K] @ camera.reference_radius ** np.array([2, 4, 6, 8]))
    if camera.model == "brown-ideal":
        scale = 1 - s
        values[0] *= scale
        values[_K] /= scale ** np.array([3, 5, 7, 9])
        values[_P] /= scale ** np.array([2, 2, 2, 4])
    else:
        scale = 1 / (1 + s)
        values[0] *= scale
        values[_K] *= scale
        values[7:9] *= scale
    if camera.affinity == "additive":
        values[_B] *= 1 / scale if camera.model == "brown-ideal" else scale
    return replace(camera, values=values, reference_radius=0.0)


def converted(
    camera: Camera, model: Model, affinity: Affinity = "after", terms: Sequence[str] | None = None
) -> Conversion:
    """Convert a camera to another model.

    terms: parameters that may be used beside c, x0, y0; all but P3 and P4 when not given. The readout is that
        of the shutter and stays.
    raises InputMalformedError: when Brown's polynomial misses another lens by more than a pixel.
    """
    camera = unbalanced(camera)
    allowed = tuple(terms or (n for n in MODELS[model].names[3:-1] if n not in ("P3", "P4")))
    used = {
        name for name, value in zip(PARAMETERS[3:_READOUT], camera.values[3:_READOUT], strict=True) if value
    }
    plain = not camera.values[_B].any()
    same = camera.affinity_form == "fraser" and (camera.affinity == affinity or plain)
    perspective = not camera.lens.angular and not MODELS[model].angular
    if same and used <= set(allowed) and (camera.model == model or (perspective and not used)):
        return Conversion(replace(camera, model=model, affinity=affinity, affinity_form="fraser"))
    conversion = _fitted(camera, model, affinity, allowed)
    # A polynomial of Brown that misses a lens by more than this is no equivalent, px.
    no_equivalent_px = 1.0
    if camera.lens.relative and not MODELS[model].relative and not conversion.largest_px < no_equivalent_px:
        raise InputMalformedError(
            f"camera {camera.id} has a {camera.model} lens, which Brown's polynomial would miss by up to "
            f"{conversion.largest_px:.3g} px",
            "export to colmap or opencv, which hold it",
        )
    return conversion


def apart_px(camera: Camera, other: Camera) -> tuple[float, float]:
    """How far apart two cameras record the same rays, over the whole image of the first."""
    measured, rays = _grid(camera)
    apart = np.hypot(*((distorted(other, other.values[0] * rays) - measured) / camera.pitch).T)
    apart[np.isnan(apart)] = np.inf
    return float(np.sqrt(np.mean(apart**2))), float(apart.max())


def _grid(camera: Camera) -> tuple[Floats, Floats]:
    """Image points over the whole image, in its plane, and the slopes of their rays, where it sees."""
    # Points on a side of the grid over the image at which models are compared.
    grid = 31
    side = [
        np.linspace(-0.5, 0.5, grid) * extent * pitch
        for extent, pitch in zip(camera.size_px, camera.pitch, strict=True)
    ]
    measured = np.stack(np.meshgrid(*side), axis=-1).reshape(-1, 2)
    rays = undistorted(camera, measured) / camera.values[0]
    seen = np.isfinite(rays).all(axis=1)
    return measured[seen], rays[seen]


def _fitted(camera: Camera, model: Model, affinity: Affinity, terms: Sequence[str]) -> Conversion:
    size = np.array(camera.size_px)
    measured, rays = _grid(camera)
    index = [0, 1, 2, *(PARAMETERS.index(name) for name in terms)]
    shared = np.isin(PARAMETERS, terms) & (camera.model == model)
    start = np.where(shared, camera.values, 0.0)
    start[:3], start[_READOUT] = camera.values[:3], camera.values[_READOUT]
    target = replace(camera, model=model, values=start, affinity=affinity, affinity_form="fraser")
    # Scaled so that each unknown moves the corner of the image by about its own size.
    radius = float(np.hypot(*(size * camera.pitch)) / 2)
    unit = radius ** MODELS[model].powers()[index] / np.where(np.arange(len(index)) < 3, radius, 1.0)

    def filled(unknown: Floats) -> Camera:
        """The camera with the unknowns put in."""
        values = start.copy()
        values[index] = start[index] + unknown * unit
        return target.with_values(values)

    def miss(unknown: Floats) -> Floats:
        """Differences of its rays from those of the other model, over the format."""
        guess = filled(unknown)
        if model == "brown-observed":
            return np.ravel(undistorted(guess, measured) - guess.values[0] * rays)
        return np.nan_to_num(np.ravel(distorted(guess, guess.values[0] * rays) - measured), nan=radius)

    result = filled(_least(miss, np.zeros(len(index))))
    return Conversion(result, *apart_px(camera, result))


def _least(miss: Callable[[Floats], Floats], unknown: Floats) -> Floats:
    """Unknowns of least squares of what they miss (Levenberg 1944, Marquardt 1963), from those given.

    Coefficients of a lens of quotients do nearly the same: steps are damped in units of what each does.
    """
    # Differences; damping at first and at most; share of the sum by which steps still pay.
    apart, damping, hopeless, pays, most = 1e-7, 1e-6, 1e6, 1e-9, 200
    missed = miss(unknown)
    for _ in range(most):
        beside = [miss(unknown + side) for side in apart * np.eye(len(unknown))]
        slope = (np.column_stack(beside) - missed[:, None]) / apart
        size = np.maximum(np.linalg.norm(slope, axis=0), np.finfo(np.float64).tiny)
        slope /= size
        normal, right, falls = slope.T @ slope, slope.T @ missed, 0.0
        while not falls > 0.0 and damping < hopeless:
            step = np.linalg.solve(normal + damping * np.eye(len(unknown)), right) / size
            trial = unknown - step
            there = miss(trial)
            falls = float(missed @ missed - there @ there)
            damping *= 0.1 if falls > 0.0 else 10.0
        if not falls > 0.0:
            break
        before, unknown, missed = float(missed @ missed), trial, there
        if falls <= pays * before:
            break
    return unknown


def require_no_skew(camera: Camera, program: str) -> None:
    """Complain when a camera has a skew that a program has no place for."""
    matrix = affinity_matrix(camera)
    if matrix[0, 1] or matrix[1, 0]:
        raise InputMalformedError(
            f"camera {camera.id} has a skew (B2), which {program} cannot hold",
            "adjust without B2, or export to Metashape",
        )
