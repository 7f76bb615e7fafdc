"""Which of Brown's two lenses a camera has, and with how many radial terms, where its pictures alone tell."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.adjust import minimum_of
from photocal.block.model import Block
from photocal.findings.finding import Figure, Finding
from photocal.geometry.camera import PARAMETERS, Camera, Model, among
from photocal.measurement.tie_adjustment import Adjusted, adjust_ties, assembled, without_readouts
from photocal.measurement.tracks import Tracks

# By how much another lens must lower v'Pv, and for each unknown more.
GAIN = 20.0
# With an estimated readout the residuals say in the end whether they are smaller.
NOT_WORSE = 1.001
_MODELS: tuple[Model, ...] = ("brown-ideal", "brown-observed")
_K4 = among("K4")
_POLYNOMIALS = slice(PARAMETERS.index("K1"), PARAMETERS.index("P4") + 1)


def before_the_choice(held: Adjusted) -> Adjusted:
    """Leave untested shutters closed until the lens is chosen: a wrong one looks like a readout."""
    cameras = tuple(
        camera if camera.rolling else replace(camera, shutter="global") for camera in held.start.cameras
    )
    return replace(held, start=replace(held.start, cameras=cameras))


def with_chosen_lenses(
    adjusted: Adjusted, block: Block, tracks: Tracks
) -> tuple[Adjusted, Block, list[Finding]]:
    """Adjust with the lens that the rays prefer: `brown-ideal` or `brown-observed`, with or without K4.

    A camera whose coefficients are held, known beforehand or of another kind is left as it is. Shutters are
    tested now.

    adjusted: with the cameras of `block`, which are to get the lens, and without readouts not found so far.
    tracks: all that may fit; what one lens refuses may fit the other.
    """
    given, used = {camera.id: camera for camera in block.cameras}, adjusted.assembly.network.cameras
    chosen = dict[str, tuple[Camera, dict[str, Figure]]]()
    for place, own in enumerate(adjusted.start.cameras):
        if _is_open(given[own.id]) and _is_open(used[place]) and (found := _preferred(adjusted, place)):
            chosen[own.id] = found
    for lenses in (chosen, {}):
        cameras = [
            lenses[own.id][0] if own.id in lenses else own
            for own in (
                without_readouts(adjusted.start.cameras, "global") if lenses else adjusted.start.cameras
            )
        ]
        cameras = [
            camera if camera.rolling else replace(camera, shutter=given[camera.id].shutter)
            for camera in cameras
        ]
        try:
            better = adjust_ties(replace(adjusted.start, cameras=tuple(cameras)), adjusted.values, tracks)
        except (IllPosedError, NotConvergedError):
            continue
        smaller = _scatter(better) <= NOT_WORSE * _scatter(adjusted)
        if not lenses or (smaller and all(_still_pays(better, adjusted, name) for name in lenses)):
            break
    else:
        return adjusted, block, []
    better = replace(better, left_out=(*adjusted.left_out, *better.left_out))
    cameras = [
        replace(
            camera,
            model=lenses[camera.id][0].model,
            estimated=camera.estimated | (_K4 & lenses[camera.id][0].estimated),
        )
        if camera.id in lenses
        else camera
        for camera in block.cameras
    ]
    findings = [Finding("lens-chosen", "note", name, figures) for name, (_, figures) in lenses.items()]
    return better, replace(block, cameras=tuple(cameras)), findings


def _is_open(camera: Camera) -> bool:
    """Whether the rays alone are to tell its lens: a polynomial of Brown, free and not known beforehand."""
    free = camera.estimated & np.isinf(camera.prior_sigma)
    lens = np.zeros_like(free)
    lens[_POLYNOMIALS] = True
    plain = camera.model in _MODELS and not (
        camera.focus_m or camera.photo_variant or camera.reference_radius
    )
    return bool(plain and (free & lens).any() and not (lens & ~free & (camera.values != 0.0)).any())


def _preferred(adjusted: Adjusted, place: int) -> tuple[Camera, dict[str, Figure]] | None:
    """The lens of least v'Pv, with what is to be said of it; None where it is the one that the camera has."""
    cameras = without_readouts(adjusted.start.cameras, "global")
    own = cameras[place]
    with_k4 = own.estimated | _K4
    variants = [own, replace(own, estimated=with_k4)]
    other: Model = _MODELS[1 - _MODELS.index(own.model)]
    # The inverse of a polynomial begins with the opposite sign.
    values = own.values.copy()
    values[_POLYNOMIALS] *= -1.0
    turned = replace(own, model=other, values=values)
    variants += [turned, replace(turned, estimated=with_k4)]
    fits = list[tuple[float, float, Camera]]()
    for lens in variants:
        try:
            chi_squared, lens = _least(adjusted, (*cameras[:place], lens, *cameras[place + 1 :]), place)
        except (IllPosedError, NotConvergedError):
            if not fits:
                return None
            continue
        fits.append((chi_squared + _needed(lens, own), chi_squared, lens))
    _, chi_squared, lens = min(fits, key=lambda fit: fit[0])
    if lens.model == own.model and (lens.estimated == own.estimated).all():
        return None
    names = tuple(name for name in lens.free if name in lens.lens.terms)
    given = fits[0][1]
    return lens, {
        "model": lens.model,
        "names": names,
        "given": own.model,
        "found": given,
        "fall": given - chi_squared,
    }


def _needed(lens: Camera, given: Camera) -> float:
    """By how much a lens must lower v'Pv."""
    unknowns = int(lens.estimated.sum() - given.estimated.sum())
    return GAIN * (unknowns + (lens.model != given.model))


def _still_pays(better: Adjusted, before: Adjusted, name: str) -> bool:
    """Whether a lens lowers v'Pv beside a readout, too: without it the rays prefer any lens that bends."""
    names = [camera.id for camera in better.start.cameras]
    place = names.index(name)
    lens = better.start.cameras[place]
    if not lens.rolling:
        return True
    given = next(camera for camera in before.start.cameras if camera.id == name)
    readout = among("readout")
    given = replace(
        lens,
        model=given.model,
        estimated=np.where(readout, lens.estimated, given.estimated),
        values=np.where(readout, lens.values, given.values),
    )
    others = list(better.start.cameras)
    try:
        with_lens = _least(better, others, place)[0]
        others[place] = given
        return _least(better, others, place)[0] - with_lens > _needed(lens, given)
    except (IllPosedError, NotConvergedError):
        return False


def _least(adjusted: Adjusted, cameras: Sequence[Camera], place: int) -> tuple[float, Camera]:
    """Least v'Pv of the same rays with other cameras, and the camera as it is there."""
    assembly, state = assembled(replace(adjusted.block, cameras=tuple(cameras)), adjusted.values)
    _, minimum = minimum_of(assembly.network, None, state)
    return minimum.iterations[-1].chi_squared, cameras[place].with_values(minimum.state.cameras[place])


def _scatter(adjusted: Adjusted) -> float:
    """What is left in the rays, each as its redundancy shows it, px."""
    sigma = adjusted.block.observations.sigma[-len(adjusted.tracks.track) :]
    return float(np.sqrt(np.mean(sigma**2) * adjusted.solution.variance_factor))
