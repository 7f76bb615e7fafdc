"""Which of Brown's two lenses a camera has, with which terms, where its pictures alone tell."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from photocal.adjustment.adjust import minimum_of
from photocal.adjustment.readout import with_loose_sides
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.block.model import Block
from photocal.findings.finding import Figure, Finding
from photocal.geometry.camera import PARAMETERS, Camera, Model, among
from photocal.measurement.tie_adjustment import (
    AdjustedTies,
    adjust_ties,
    assembled,
    ray_rms_px,
    without_readouts,
)
from photocal.measurement.tracks import Tracks

# With an estimated readout the residuals say in the end whether they are smaller.
NOT_WORSE = 1.001
_MODELS: tuple[Model, ...] = ("brown-ideal", "brown-observed")
_K4, _SCALE = among("K4"), among("B1", "B2")
Chosen = tuple[Camera, dict[str, Figure]]
_POLYNOMIALS = slice(PARAMETERS.index("K1"), PARAMETERS.index("P4") + 1)


def with_shutters_closed(held: AdjustedTies) -> AdjustedTies:
    """Leave untested shutters closed until the lens is chosen: a wrong one looks like a readout."""
    cameras = tuple(
        camera if camera.rolling else replace(camera, shutter="global") for camera in held.start.cameras
    )
    return replace(held, start=replace(held.start, cameras=cameras))


def with_chosen_lenses(
    adjusted: AdjustedTies, block: Block, tracks: Tracks
) -> tuple[AdjustedTies, Block, list[Finding]]:
    """Adjust with the lens that the rays prefer: `brown-ideal` or `brown-observed`, more terms or not.

    These are K4, and a scale of y against x. A rolling shutter feigns that one: it is observed as one until
    it pays beside a readout. Shutters are tested now. A camera whose coefficients are held, known beforehand
    or of another kind is left as it is.

    adjusted: with the cameras of `block`, which are to get the lens, and without readouts not found so far.
    tracks: all that may fit; what one lens refuses may fit the other.
    """
    given, used = {camera.id: camera for camera in block.cameras}, adjusted.assembly.network.cameras
    choices = {
        camera.id: _preferred(adjusted, place)
        for place, camera in enumerate(adjusted.start.cameras)
        if _is_open(given[camera.id]) and _is_open(used[place])
    }
    # What a rolling shutter feigned is taken back: the scale first.
    for nth in range(1 + max(map(len, choices.values()), default=0)):
        lenses = {name: lens[nth] for name, lens in choices.items() if nth < len(lens)}
        plain = without_readouts(adjusted.start.cameras) if lenses else adjusted.start.cameras
        cameras = [lenses[camera.id][0] if camera.id in lenses else camera for camera in plain]
        cameras = [
            camera if camera.rolling else replace(camera, shutter=given[camera.id].shutter)
            for camera in cameras
        ]
        try:
            better = adjust_ties(replace(adjusted.start, cameras=tuple(cameras)), adjusted.values, tracks)
        except (IllPosedError, NotConvergedError):
            continue
        smaller = ray_rms_px(better) <= NOT_WORSE * ray_rms_px(adjusted)
        if not lenses or (smaller and all(_still_pays(better, adjusted, name) for name in lenses)):
            break
    else:
        return adjusted, block, []
    better = replace(better, left_out=(*adjusted.left_out, *better.left_out))
    cameras = [
        replace(
            camera,
            model=lenses[camera.id][0].model,
            estimated=camera.estimated | lenses[camera.id][0].estimated & (_K4 | _SCALE),
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


def _preferred(adjusted: AdjustedTies, place: int) -> list[Chosen]:
    """Lenses of least v'Pv and what is to be said of them, with a scale and without; none that is the own."""
    cameras = without_readouts(adjusted.start.cameras)
    camera = cameras[place]
    with_k4 = camera.estimated | _K4
    variants = [camera, replace(camera, estimated=with_k4)]
    other: Model = _MODELS[1 - _MODELS.index(camera.model)]
    # The inverse of a polynomial begins with the opposite sign.
    values = camera.values.copy()
    values[_POLYNOMIALS] *= -1.0
    turned = replace(camera, model=other, values=values)
    variants += [turned, replace(turned, estimated=with_k4)]
    fits = list[tuple[float, float, Camera]]()
    for lens in variants:
        try:
            chi_squared, lens = _least(adjusted, (*cameras[:place], lens, *cameras[place + 1 :]), place)
        except (IllPosedError, NotConvergedError):
            if not fits:
                return []
            continue
        fits.append((chi_squared + _needed(lens, camera), chi_squared, lens))
    given, best = fits[0][1], min(fits, key=lambda fit: fit[0])
    preferred = [best[1:]] if best is not fits[0] else []
    scaled = with_loose_sides(best[2])
    with suppress(IllPosedError, NotConvergedError):
        chi_squared, scaled = _least(adjusted, (*cameras[:place], scaled, *cameras[place + 1 :]), place)
        if chi_squared + _needed(scaled, best[2]) < best[1]:
            preferred.insert(0, (chi_squared, scaled))
    return [
        (
            lens,
            {
                "model": lens.model,
                "names": tuple(name for name in lens.free if name in (*lens.lens.terms, "B1", "B2")),
                "given": camera.model,
                "found": given,
                "fall": given - chi_squared,
            },
        )
        for chi_squared, lens in preferred
    ]


def _needed(lens: Camera, given: Camera) -> float:
    """By how much a lens must lower v'Pv."""
    unknowns = int(lens.estimated.sum() - given.estimated.sum())
    # By how much another lens must lower v'Pv, and for each unknown more.
    gain = 20.0
    return gain * (unknowns + (lens.model != given.model))


def _still_pays(better: AdjustedTies, before: AdjustedTies, name: str) -> bool:
    """Whether a lens lowers v'Pv beside a readout, too: without it the rays prefer any lens that bends."""
    names = [camera.id for camera in better.start.cameras]
    place = names.index(name)
    lens = better.start.cameras[place]
    if not lens.rolling:
        return True
    given = next(camera for camera in before.start.cameras if camera.id == name)
    scale = np.where(given.estimated, False, _SCALE & lens.estimated)
    free = np.where(among("readout"), lens.estimated, given.estimated)
    kept = np.where(among("readout"), lens.values, given.values)
    rivals = [replace(lens, model=given.model, estimated=free, values=kept)]
    if scale.any():
        rivals.append(
            replace(lens, estimated=lens.estimated & ~scale, values=np.where(scale, 0.0, lens.values))
        )
    others = list(better.start.cameras)
    try:
        with_lens = _least(better, others, place)[0]
        for rival in rivals:
            others[place] = rival
            if not _least(better, others, place)[0] - with_lens > _needed(lens, rival):
                return False
    except (IllPosedError, NotConvergedError):
        return False
    return True


def _least(adjusted: AdjustedTies, cameras: Sequence[Camera], place: int) -> tuple[float, Camera]:
    """Least v'Pv of the same rays with other cameras, and the camera as it is there."""
    assembly, state = assembled(replace(adjusted.block, cameras=tuple(cameras)), adjusted.values)
    _, minimum = minimum_of(assembly.network, None, state)
    return minimum.iterations[-1].chi_squared, cameras[place].with_values(minimum.state.cameras[place])
