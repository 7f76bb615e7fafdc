"""The cameras of a project released, as far as the block bears it, once gross errors are out."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from photocal.adjustment.readout import left_by_movement
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.policy import policy
from photocal.block.model import Block
from photocal.findings.finding import Figure, Finding
from photocal.geometry.camera import PARAMETERS, Camera, among
from photocal.measurement.lens_choice import with_chosen_lenses, with_shutters_closed
from photocal.measurement.oriented_ties import Oriented
from photocal.measurement.start_block import without_images, without_single_rays
from photocal.measurement.tie_adjustment import AdjustedTies, adjust_ties, assembled, ray_rms_px
from photocal.measurement.tie_block import marked_control, place, rescaled_poses, with_ties
from photocal.measurement.tie_orientation import KEPT_MISFIT, OF_POSITIONS, position_sigmas
from photocal.measurement.tracks import of_images

# While gross errors are sought these are held: a level block determines them only with precise positions,
# which the measurement does not use.
HELD = ("c", "x0", "y0")
# What is held, step by step, where a block does not bear all that its project estimates.
HOLDING: tuple[tuple[str, ...], ...] = ((), HELD, PARAMETERS)
# From this share on poses of one principal distance are no start for another.
ANOTHER_C = 0.02
# Rays that miss by more leave something to explain. Movement while images are read leaves 0.19 of v'Pv in a
# flight with 30 ms, 0.79 in one with two principal distances, and 0.996 to 0.998 in four with neither.
ROUGH_PX, MOVES = 0.3, 0.5


def with_released_cameras(
    oriented: Oriented, block: Block, holding: Sequence[Sequence[str]], *, open_lens: bool
) -> tuple[AdjustedTies, Block, list[Finding]]:
    """Adjust with all that the cameras of a block estimate, and restore what was given in the block.

    holding: what is held, step by step, where the block does not bear it all.
    open_lens: whether the rays are to tell which lens it is.
    returns: the adjustment, the measured block, and what was found.
    """
    # Positions of a flight log come later, and with them what determines c.
    held, wanted = oriented.adjusted, block.cameras
    released, block, findings = release(with_shutters_closed(held) if open_lens else held, block, holding)
    if open_lens:
        # What one lens refused may fit the other.
        stay = np.isin(held.block.images.names, released.block.images.names)
        released, block, chosen = with_chosen_lenses(released, block, of_images(held.tracks, stay))
        findings += chosen
    findings += _moving(released)
    measured, of_positions = _restored(held, released, block)
    still = [finding for finding in oriented.findings if not _outdated(finding, wanted)]
    return released, measured, [*still, *of_positions, *findings]


def release(
    held: AdjustedTies, block: Block, holding: Sequence[Sequence[str]]
) -> tuple[AdjustedTies, Block, list[Finding]]:
    """Adjust once more with all parameters that the project estimates and the block bears.

    Only now the residuals are those of the measurements: a principal point that is held wrongly would go
    into the sigmas. The exterior orientation of it is not used, for c may drift with the heights. What runs
    away, or leaves all that is known of it beforehand, is held as it was given; unless the rays then miss by
    far more: what was known is not of these pictures, which were cut or enlarged.
    """
    asked = {camera.id: camera for camera in block.cameras}
    refusal: dict[str, Figure] = {}
    apart: AdjustedTies | None = None
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
        if np.abs(ratio - 1.0).max() > ANOTHER_C:
            poses = rescaled_poses(held.start, poses, held.tracks, ratio[start.images.camera])
        try:
            released = adjust_ties(start, poses, held.tracks)
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
    # What the model lacks (a rolling shutter above all) goes into c, which then leaves what was known of it.
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
    bare = without_images(block, ~np.isin(block.images.names, names))
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
    oriented = without_images(held.start, ~remaining)
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
