"""Stage `block`: what was measured in the images and what GNSS and inertial unit observed, in one folder."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from photocal.adjustment.mounting import Attitudes, Positions
from photocal.adjustment.network import RELATIONS, Relations
from photocal.base.arrays import Flags, Integers
from photocal.base.errors import InputMalformedError, InputNotFoundError
from photocal.base.progress import Progress
from photocal.block.model import Block
from photocal.block.project import Project
from photocal.block.setup import MountingKeys
from photocal.findings.finding import Finding
from photocal.findings.listed import Findings
from photocal.geometry.rotation import object_to_body
from photocal.geometry.strips import strips
from photocal.run.stage import Stage, pictures_of

if TYPE_CHECKING:
    from photocal.navigation.exposures import Exposures

# What is to be said of a block as it was joined.
FINDINGS = "findings.json"
# Of a rate between two attitudes of an autopilot, some hundredths of a second apart.
_RATE_SIGMA = np.radians(2.0)


def block_stage(project: Project, exposures: Path | None, measurements: Path) -> Stage:
    """Describe the stage, which follows those whose folders are given; exposures None without a flight."""
    distances, bent = project.control.distances, project.contents.project.refraction

    def surveyed() -> tuple[str, ...]:
        """Names of all points that the project has."""
        from photocal.measurement.picture_block import control_points

        return control_points(project).names

    def make(folder: Path, _: Progress) -> None:
        """Make the files of the stage."""
        from photocal.block.folder import read_block
        from photocal.measurement.measurement_record import RECORD
        from photocal.run.project_checks import check_rays

        block = read_block(measurements)
        findings: list[Finding] = []
        if distances is not None:
            given, findings = known_distances(distances, block.points.names, surveyed())
            others = block.relations.rows(block.relations.kind != list(RELATIONS).index("distance"))
            block = replace(block, relations=given.plus(others))
        if bent is not None:
            block = replace(block, refraction=bent)
        if exposures is not None:
            block = _flown(block, exposures, project.rig.mounting(), project.crs)
            check_rays(block, project.control.points)
        _write_as_chosen(folder, block, project, findings)
        if (measurements / RECORD).exists():
            shutil.copyfile(measurements / RECORD, folder / RECORD)

    inputs, chosen = _choices(project)
    inputs |= {} if distances is None else {"distances": distances}
    chosen |= {} if bent is None else {"refraction": bent}
    if exposures is None:
        return Stage("block", "the block", make, inputs, chosen, (measurements,))
    settings = {"rig": project.rig.mounting().model_dump(mode="json"), "crs": project.crs, **chosen}
    return Stage("block", "the block", make, inputs, settings, (exposures, measurements))


def known_distances(
    path: Path, points: Sequence[str], listed: Sequence[str]
) -> tuple[Relations, list[Finding]]:
    """Read distances, and name those with an end that is listed and no point of the block."""
    from photocal.block.folder import read_relations

    lost = tuple(name for name in listed if name not in set(points))
    names = (*points, *lost)
    given = read_relations(path, "distance", names)
    here = (given.ends[:, :2] < len(points)).all(axis=1)
    findings = []
    for start, end in given.ends[~here, :2].tolist():
        missing = tuple(names[k] for k in (start, end) if k >= len(points))
        figures = {"start": names[start], "end": names[end], "missing": missing}
        findings.append(
            Finding("distance-left-out", "doubtful", f"{names[start]}, {names[end]}", figures=figures)
        )
    return given.rows(here), findings


def _flown(block: Block, exposures: Path, keys: MountingKeys, crs: str) -> Block:
    """The block with what was observed at its exposures, and what the errors of all positions share."""
    from photocal.block.mounting import make_mounting
    from photocal.run.exposures import EXPOSURES, FIGURES, ExposureFigures

    common = ExposureFigures.read(exposures / FIGURES).common
    if common is not None:
        keys = keys.model_copy(
            update={
                "flight_shift_sigma_m": tuple(common.shift_sigma_m.tolist()),
                "height_scale_sigma": common.zenith_scale_sigma,
                "height_scale_from_m": common.base_height_m,
            }
        )

    from photocal.navigation.exposures import Exposures

    antenna = Exposures.read(exposures / EXPOSURES)
    positions = observed_positions(antenna, block.images.names, crs, keys.height_scale_from_m or 0.0)
    return replace(
        block,
        positions=positions,
        attitudes=observed_attitudes(antenna, block.images.names),
        mounting=make_mounting(keys, int(positions.strip.max(initial=-1)) + 1),
    )


def observed_positions(
    antenna: Exposures, images: tuple[str, ...], crs: str, above_from_m: float
) -> Positions:
    """Give where the antenna was at the images of a block; some have no usable points, or no position.

    crs: system of the block.
    above_from_m: height of the base station's antenna.
    raises InputMalformedError: for a position without covariance.
    """
    from photocal.navigation.exposure_files import projected, with_images

    rows = with_images(antenna)
    p, seconds = antenna.placed.rows(rows), (antenna.time.ns[rows] - antenna.time.ns[rows[:1]]) / 1e9
    xyz, turn = projected(p.lat_deg, p.lon_deg, p.height_m, crs)
    covariance = turn @ p.covariance_m2 @ np.swapaxes(turn, 1, 2)
    velocity = np.nan_to_num(np.einsum("nab,nb->na", turn, p.velocity_m_s))
    strip, elapsed = strips(seconds, velocity)
    event, image = _taken(antenna, rows, images)
    event = np.searchsorted(rows, event)
    known = np.asarray(np.isfinite(covariance[event]).all(axis=(1, 2)))
    _refuse(~known, "position", [images[k] for k in image], "let a base station record, or give no [flight]")
    # Strips are numbered by their first image that takes part.
    first = {number: k for k, number in enumerate(dict.fromkeys(strip[event].tolist()))}
    numbers = np.array([first[number] for number in strip[event].tolist()], dtype=np.int64)
    values = xyz[event]
    above = values[:, 2] - above_from_m
    return Positions(image, values, covariance[event], velocity[event], numbers, elapsed[event], above)


def observed_attitudes(antenna: Exposures, images: tuple[str, ...]) -> Attitudes:
    """Give how the vehicle was turned at the images of a block; exposures without attitude are left out.

    raises InputMalformedError: for an attitude without standard deviations.
    """
    from photocal.navigation.exposure_files import with_images

    rows = with_images(antenna)
    event, image = _taken(antenna, rows[antenna.attitude.known[rows]], images)
    angles, sigma = antenna.angles[event], antenna.angle_sigma[event]
    stated = np.asarray((np.isfinite(sigma) & (sigma > 0)).all(axis=1))
    _refuse(~stated, "attitude", [images[k] for k in image], "give attitude_sigma_deg in [rig]")
    rotation, per_angle = object_to_body(angles)
    covariance = per_angle @ (sigma[:, :, None] ** 2 * np.swapaxes(per_angle, 1, 2))
    rate = antenna.attitude.rate[event]
    unknown = ~np.asarray(rate.any(axis=1))[:, None]
    rate_sigma = np.where(unknown, np.nan, np.full(rate.shape, _RATE_SIGMA))
    return Attitudes(image, rotation, covariance, np.where(unknown, np.nan, rate), rate_sigma)


def _taken(antenna: Exposures, rows: Integers, images: tuple[str, ...]) -> tuple[Integers, Integers]:
    """Rows of events and the images of the block that were taken at them."""
    place = {name: k for k, name in enumerate(images)}
    pairs = [(row, place[name]) for row in rows.tolist() for name in antenna.images[row] if name in place]
    event, image = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return event, image


def _refuse(bad: Flags, what: str, names: list[str], remedy: str) -> None:
    if bad.any():
        name = names[int(np.flatnonzero(bad)[0])]
        raise InputMalformedError(f"the {what} of image {name} has no standard deviation", remedy)


def _choices(project: Project) -> tuple[dict[str, Path], dict[str, Any]]:
    """Inputs and settings for what a person leaves out, and for laser distances as observations."""
    contents, inputs, settings = project.contents, dict[str, Path](), dict[str, Any]()
    if contents.leave_out:
        settings["leave_out"] = [entry.model_dump(mode="json") for entry in contents.leave_out]
    if contents.images is not None and contents.images.laser != "check":
        settings["laser"] = contents.images.laser
        inputs = pictures_of(project)
    return inputs, settings


def _write_as_chosen(folder: Path, block: Block, project: Project, findings: Sequence[Finding] = ()) -> None:
    """Write a block as a person has chosen, and beside it what is to be said of how it was joined."""
    from photocal.block.writer import write_block

    _, chosen = _choices(project)
    if "leave_out" in chosen:
        from photocal.run.left_out import left_out

        block, by_hand = left_out(block, project.contents.leave_out)
        findings = (*findings, *by_hand)
    if "laser" in chosen:
        from photocal.run.laser_distances import with_lasers
        from photocal.run.project_checks import facts_of_pictures

        block, ranged = with_lasers(block, facts_of_pictures(project, None))
        findings = (*findings, ranged)
    write_block(folder, block)
    if findings:
        Findings(tuple(findings)).write(folder / FINDINGS)


def given_block_stage(project: Project, source: Path) -> Stage:
    """Describe the stage that takes a ready block folder over, but for what a person leaves out."""

    def make(folder: Path, _: Progress) -> None:
        """Make the files of the stage."""
        if not (source / "block.toml").is_file():
            raise InputNotFoundError(
                "has no block.toml", "name a block folder in [measurements]", where=source
            )
        if not chosen:
            shutil.copytree(source, folder, dirs_exist_ok=True)
            return
        from photocal.block.folder import read_block

        _write_as_chosen(folder, read_block(source), project)

    inputs, chosen = _choices(project)
    return Stage("block", "the block", make, {"block": source, **inputs}, chosen)
