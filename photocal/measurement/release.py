"""The cameras of a project released, as far as the block determines them, once gross errors are out.

Which of Brown's two lenses a camera has, with which terms, where its pictures alone tell.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from photocal.adjustment.adjust import minimum_of
from photocal.adjustment.network import own_sigma
from photocal.adjustment.readout import left_by_movement, with_loose_sides
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.policy import policy
from photocal.block.model import Block
from photocal.findings.finding import Figure, Finding
from photocal.geometry.camera import PARAMETERS, Camera, Model, among
from photocal.measurement.oriented_ties import Oriented
from photocal.measurement.tie_adjustment import (
    AdjustedTies,
    adjust_ties,
    adjusted_again,
    assembled,
    ray_rms_px,
    shutters_closed,
    with_vibration,
    without_readouts,
)
from photocal.measurement.tie_block import (
    marked_control,
    place,
    rescaled_poses,
    with_ties,
    without_single_rays,
)
from photocal.measurement.tie_orientation import KEPT_MISFIT, OF_POSITIONS, position_sigmas
from photocal.measurement.tracks import Tracks, of_images

_MODELS: tuple[Model, ...] = ("brown-ideal", "brown-observed")
_K4, _SCALE = among("K4"), among("B1", "B2")
Chosen = tuple[Camera, dict[str, Figure]]
_POLYNOMIALS = slice(PARAMETERS.index("K1"), PARAMETERS.index("P4") + 1)


def with_shutters_closed(held: AdjustedTies) -> AdjustedTies:
    """Leave untested shutters closed until the lens is chosen: a wrong one looks like a readout."""
    return replace(held, start=replace(held.start, cameras=shutters_closed(held.start.cameras)))


def with_chosen_lenses(
    adjusted: AdjustedTies, block: Block, tracks: Tracks
) -> tuple[AdjustedTies, Block, list[Finding]]:
    """Adjust with the lens that fits better: `brown-ideal` or `brown-observed`, more terms or not.

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
        if not lenses or (
            _fits_as_well(better, adjusted) and all(_still_pays(better, adjusted, name) for name in lenses)
        ):
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

    def least(lenses: Sequence[Camera]) -> list[tuple[float, Camera]]:
        """Least v'Pv with each lens that the block bears."""
        fits = list[tuple[float, Camera]]()
        for lens in lenses:
            with suppress(IllPosedError, NotConvergedError):
                fits.append(_least(adjusted, (*cameras[:place], lens, *cameras[place + 1 :]), place))
        return fits

    def criterion(fit: tuple[float, Camera]) -> float:
        """What v'Pv must be judged by: with what the unknowns of its lens must bring."""
        return fit[0] + _needed(fit[1], camera)

    own = least(variants[:1])
    if not own:
        return []
    fits = [*own, *least(variants[1:])]
    given, best = own[0][0], min(fits, key=criterion)
    preferred = [] if best is own[0] else [best]
    # Which polynomial a camera has shows only once nothing else bends the rays.
    scaled = min(least([with_loose_sides(lens) for _, lens in fits]), key=criterion, default=best)
    if criterion(scaled) < criterion(best):
        preferred.insert(0, scaled)
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


# By how much another lens must lower v'Pv, and for each unknown more.
_GAIN = 20.0


def _needed(lens: Camera, given: Camera) -> float:
    """By how much a lens must lower v'Pv."""
    unknowns = int(lens.estimated.sum() - given.estimated.sum())
    return _GAIN * (unknowns + (lens.model != given.model))


def _fits_as_well(better: AdjustedTies, before: AdjustedTies) -> bool:
    """Whether other lenses leave no more v'Pv in the same rays than the first ones, which may have readouts.

    That pixels are square was assumed to find the lens: the rays alone decide between a scale and a readout.
    """
    given = {camera.id: camera for camera in before.start.cameras}
    cameras = [
        replace(
            camera, prior_sigma=np.where(_SCALE & ~given[camera.id].estimated, np.inf, camera.prior_sigma)
        )
        for camera in better.start.cameras
    ]
    left = before.solution.chi_squared
    try:
        # Images that move on their own while they are read fit better by chance: a lens without a readout
        # competes with readouts that pay for that, and with those in which all images move as flown.
        if not any(camera.rolling for camera in cameras):
            as_flown = [
                camera.changed(readout=0.0) if camera.rolling else camera for camera in given.values()
            ]
            left = min(left + _narrowed(before), _least(before, as_flown, 0)[0] - _GAIN)
        return _least(before, cameras, 0)[0] <= left
    except (IllPosedError, NotConvergedError):
        return False


def _narrowed(adjusted: AdjustedTies) -> float:
    """By how much movements of the images must lower v'Pv to be likelier than none (Laird and Ware, 1982).

    Twice the logarithm of what the rays leave of their standard deviations, each taken alone.
    """
    own, prior = adjusted.solution.photo_variant, own_sigma(adjusted.assembly.network)
    moves = own.parameter >= len(PARAMETERS)
    stated = prior[own.image[moves], own.parameter[moves]]
    return float(2.0 * np.log(stated / own.deviation_sigma[moves]).sum())


def _still_pays(better: AdjustedTies, before: AdjustedTies, name: str) -> bool:
    """Whether a lens lowers v'Pv beside a readout, too: without it any lens with more terms fits better."""
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
    # Of a v'Pv that must fall by 20 it shows nothing: the squared distance to the minimum that is left.
    near = 1e-3
    _, minimum = minimum_of(assembly.network, None, state, near)
    return minimum.iterations[-1].chi_squared, cameras[place].with_values(minimum.state.cameras[place])


# During the search for gross errors these are held: a level block determines them only with precise
# positions, which the measurement does not use.
HELD = ("c", "x0", "y0")
# What is held, step by step, where a block does not bear all that its project estimates.
HOLDING: tuple[tuple[str, ...], ...] = ((), HELD, PARAMETERS)
# Rays that miss by more leave something to explain. Movement while images are read leaves 0.19 of v'Pv in a
# flight with 30 ms, 0.79 in one with two principal distances, and 0.996 to 0.998 in four with neither.
ROUGH_PX, MOVES = 0.3, 0.5


# Release, choice of the lens, vibration: about the same time each where images move while they are read.
STEPS = 3


def with_released_cameras(
    oriented: Oriented,
    block: Block,
    holding: Sequence[Sequence[str]],
    *,
    open_lens: bool,
    done: Callable[[float], None] = lambda _: None,
) -> tuple[AdjustedTies, Block, list[Finding]]:
    """Adjust with all that the cameras of a block estimate, and restore what was given in the block.

    holding: what is held, step by step, where the block does not bear it all.
    open_lens: whether the rays are to tell which lens it is.
    done: told when each of the `STEPS` ends.
    returns: the adjustment, the measured block, and what was found.
    """
    # Positions of a flight log come later, and with them what determines c.
    held, wanted = oriented.adjusted, block.cameras
    released, block, findings = release(with_shutters_closed(held) if open_lens else held, block, holding)
    done(1)
    if open_lens:
        # What one lens refused may fit the other.
        stay = np.isin(held.block.images.names, released.block.images.names)
        released, block, chosen = with_chosen_lenses(released, block, of_images(held.tracks, stay))
        findings += chosen
    done(1)
    # Not before: beside a readout that a wrong lens feigned images seem to vibrate, too.
    released, needless = _without_needless_scales(with_vibration(released), wanted)
    if needless:
        cameras = (
            replace(camera, estimated=camera.estimated & ~_SCALE) if camera.id in needless else camera
            for camera in block.cameras
        )
        block = replace(block, cameras=tuple(cameras))
        findings = [f for f in findings if f.code != "lens-chosen" or f.subject not in needless]
    findings += _moving(released)
    measured, of_positions = _restored(held, released, block)
    still = [finding for finding in oriented.findings if not _outdated(finding, wanted)]
    return released, measured, [*still, *of_positions, *findings]


def _without_needless_scales(
    released: AdjustedTies, wanted: Sequence[Camera]
) -> tuple[AdjustedTies, set[str]]:
    """Take scales back that were chosen beside a readout, and pay no more where images may vibrate, too.

    returns: the cameras that lose one.
    """
    asked, cameras, needless = {camera.id: camera for camera in wanted}, released.start.cameras, set[str]()
    for k, camera in enumerate(cameras):
        scale = np.where(asked[camera.id].estimated, False, _SCALE & camera.estimated)
        if not (camera.rolling and scale.any()):
            continue
        values = np.where(scale, asked[camera.id].values, camera.values)
        plain = replace(camera, estimated=camera.estimated & ~scale, values=values)
        others = (*cameras[:k], plain, *cameras[k + 1 :])
        with suppress(IllPosedError, NotConvergedError):
            if _least(released, others, k)[0] - _least(released, cameras, k)[0] <= _GAIN * scale.sum():
                cameras = others
                needless.add(camera.id)
    if not needless:
        return released, needless
    start = replace(released.start, cameras=cameras)
    return adjusted_again(released, start, released.values).after(released), needless


def release(
    held: AdjustedTies, block: Block, holding: Sequence[Sequence[str]]
) -> tuple[AdjustedTies, Block, list[Finding]]:
    """Adjust once more with all parameters that the project estimates and the block determines.

    Only now the residuals are those of the measurements: a principal point that is held wrongly would go
    into the sigmas. The exterior orientation of it is not used, for c may drift with the heights. What
    diverges, or leaves all that is known of it beforehand, is held as it was given; unless the rays then miss
    by far more: what was known is not of these pictures, which were cut or enlarged.
    """
    asked = {camera.id: camera for camera in block.cameras}
    refusal: dict[str, Figure] = {}
    apart: AdjustedTies | None = None
    # From this share on poses of one principal distance are no start for another.
    another_c = 0.02
    for held_here in holding:
        # Nobody asks for a readout: that it has one, an unknown shutter has shown.
        free, readout = ~among(*held_here), among("readout")
        cameras = tuple(
            replace(
                camera,
                estimated=(asked[camera.id].estimated | (camera.estimated & readout)) & free,
                prior_sigma=asked[camera.id].prior_sigma,
                values=np.where(free, camera.values, asked[camera.id].values),
                given=asked[camera.id].values,
            )
            for camera in held.start.cameras
        )
        poses, start = held.values, replace(held.start, cameras=cameras)
        ratio = np.array(
            [a.value("c") / b.value("c") for a, b in zip(cameras, held.start.cameras, strict=True)]
        )
        if np.abs(ratio - 1.0).max() > another_c:
            poses = rescaled_poses(held.start, poses, held.tracks, ratio[start.images.camera])
        try:
            released = adjusted_again(held, start, poses)
            why = _not_borne(released, asked, cameras)
        except (IllPosedError, NotConvergedError):
            if held_here == holding[-1]:
                raise
            why = {"camera": cameras[0].id}
        if not why or held_here == holding[-1]:
            break
        refusal = refusal or why
        if "value" in why:
            apart = released
    if apart is not None and ray_rms_px(released) > KEPT_MISFIT * ray_rms_px(apart):
        refuted = str(refusal["camera"])
        cameras = tuple(
            replace(
                camera, prior_sigma=np.where(among("c") & (camera.id == refuted), np.inf, camera.prior_sigma)
            )
            for camera in block.cameras
        )
        findings = [Finding("c-refuted-by-rays", "doubtful", refuted, refusal)]
        return apart, replace(block, cameras=cameras), findings
    # What is held has no prior: it would be an observation of what is no unknown.
    kept = tuple(
        replace(
            camera, estimated=camera.estimated & free, prior_sigma=np.where(free, camera.prior_sigma, np.inf)
        )
        for camera in block.cameras
    )
    findings = list[Finding]()
    used = np.isin(np.arange(len(kept)), released.start.images.camera)
    for camera, before, in_use in zip(kept, block.cameras, used, strict=True):
        gone = before.estimated & ~camera.estimated
        if in_use and gone.any():
            names = tuple(n for n, lost in zip(PARAMETERS, gone, strict=True) if lost)
            clause = "would-become" if "value" in refusal else "run-away"
            findings.append(
                Finding("camera-held", "doubtful", camera.id, {"names": names, **refusal}, (clause,))
            )
    return released, replace(block, cameras=kept), findings


def _not_borne(
    released: AdjustedTies, given: Mapping[str, Camera], wanted: Sequence[Camera]
) -> dict[str, Figure]:
    """What shows that a block does not bear the parameters that were to be estimated; empty when it does."""
    ids = {camera.id for camera in released.start.cameras}
    wanted = [camera for camera in wanted if camera.id in ids]
    for camera, used in zip(wanted, released.assembly.network.cameras, strict=True):
        if (camera.estimated & ~used.estimated).any():
            return {"camera": camera.id}
    # What the model lacks (a rolling shutter above all) biases c, which then leaves what was known of it.
    for camera in released.start.cameras:
        first = given[camera.id]
        away, prior = abs(camera.value("c") - first.value("c")), float(first.prior_sigma[0])
        if camera.estimated[0] and away > (policy.contradicted * prior if np.isfinite(prior) else np.inf):
            given_c = first.value("c")
            return {"camera": camera.id, "value": camera.value("c"), "given": given_c, "unit": camera.unit}
    return {}


def _restored(held: AdjustedTies, released: AdjustedTies, block: Block) -> tuple[Block, list[Finding]]:
    """The measured block with cameras, surveyed coordinates and observed values as they were given.

    Also what the rays say of its positions, beside the released cameras: a principal point that is held
    wrongly moves images by more than good positions are wrong.
    """
    names = released.block.images.names
    bare = block.of_images(np.isin(block.images.names, names))
    remaining = np.isin(held.block.images.names, names)
    borne, findings = np.full_like(bare.images.sigma, np.inf), list[Finding]()
    if released.start.datum == "free":
        bare = without_single_rays(bare)
    else:
        shifted = len(marked_control(block)) >= policy.fewest_control
        borne, _, findings = position_sigmas(bare.images, released.values, shifted=shifted)
        # An image may be held level where all positions lie in a line.
        borne[:, :3] = released.start.images.sigma[:, :3]
    bare = replace(bare, datum=released.start.datum, images=replace(bare.images, sigma=borne))
    known = np.hstack([released.start.images.values[:, :3], bare.images.values[:, 3:]])
    poses = np.where(np.isfinite(borne), known, held.values[remaining])
    oriented = held.start.of_images(remaining)
    oriented = replace(oriented, images=replace(oriented.images, values=held.values[remaining]))
    values = place(oriented, released.tracks, 0.0)
    sigma = released.block.observations.sigma[len(bare.observations.image) :, 0]
    bare = replace(bare, images=replace(bare.images, values=poses))
    return with_ties(bare, released.tracks, values, sigma), findings


def _outdated(finding: Finding, cameras: Sequence[Camera]) -> bool:
    """Whether the released cameras tell it better, or it says only that c is estimated, as is asked for."""
    if finding.code in OF_POSITIONS:
        return True
    if finding.code != "c-refuted-by-rays":
        return False
    camera = next(camera for camera in cameras if camera.id == finding.subject)
    change = abs(finding.figures["value"] - finding.figures["given"])
    return bool(camera.estimated[0]) and change <= policy.contradicted * float(camera.prior_sigma[0])


def _moving(adjusted: AdjustedTies) -> list[Finding]:
    """Images that move while they are read, where the flight does not tell how long that takes."""
    cameras, px = adjusted.start.cameras, ray_rms_px(adjusted)
    doubtful = [camera.id for camera in cameras if camera.shutter == "unknown" and not camera.rolling]
    if not doubtful or px < ROUGH_PX:
        return []
    network = assembled(replace(adjusted.block, cameras=cameras), adjusted.values)[0].network
    share = left_by_movement(network, adjusted.solution)
    if share > MOVES:
        return []
    figures: dict[str, Figure] = {"px": px, "left_px": px * float(np.sqrt(share))}
    return [Finding("images-move", "doubtful", name, figures) for name in doubtful]
