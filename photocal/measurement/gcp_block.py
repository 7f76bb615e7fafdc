"""From a folder of images and a file of marked control points to a block in the control's system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.findings.finding import Finding
from photocal.findings.texts import told
from photocal.measurement.control_files import ControlMarks, in_map_system, read_control_marks
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.maker_camera import NO_LENS, GivenLens, stated_camera
from photocal.measurement.marks import with_marks
from photocal.measurement.marks_files import named_after
from photocal.measurement.match_images import MatchingPlan
from photocal.measurement.measure_ties import TieBlock, sight, stated_footprints, tie_record
from photocal.measurement.oriented_ties import FEWEST_CONTROL, Progress, orient_ties
from photocal.measurement.position_files import map_places
from photocal.measurement.project_block import OTHER_SURFACE_M, findings_of_marks, suspected_marks
from photocal.measurement.start_block import start_block
from photocal.measurement.tie_block import marked_control


def measure_gcp(
    paths: Sequence[Path],
    control_file: Path,
    sigma_m: tuple[float, float],
    system: tuple[str, str],
    name: str,
    plan: MatchingPlan,
    progress: Progress,
    lens: GivenLens = NO_LENS,
) -> TieBlock:
    """Measure tie points in images and join them with marked control points.

    system: coordinate reference system in place of the file's, or empty; and the kind of the heights.
    raises PhotocalError: when the file cannot be read, or the images are not oriented.
    """
    # What is wrong with the file is told before the images are looked at.
    first = read_control_marks(control_file, sigma_m, {})
    if first.crs != "local" and system[1] not in ("ellipsoidal", "orthometric"):
        raise ConfigurationError(
            "does not say what its heights are",
            where=control_file,
            remedy="give --height ellipsoidal or --height orthometric",
        )
    sighted = sight(paths, plan, progress, stated_footprints, lens.of)
    sizes = {own.name: own.size_px for own in sighted.facts}
    given = read_control_marks(control_file, sigma_m, sizes)
    crs, height = system
    given = replace(given, crs=crs) if crs else in_map_system(given)
    start = start_block(sighted.facts, _places(sighted.facts, given), name)
    start = replace(
        start,
        frame=given.crs,
        height="" if given.crs == "local" else height,
        datum="control",
        points=given.points,
    )
    start, unknown = with_marks(start, named_after(given.marks, sizes))
    if len(marked_control(start)) >= FEWEST_CONTROL:
        known = np.isfinite(start.images.sigma[:, 5])
        start.images.sigma[known, 5] = OTHER_SURFACE_M
    found = orient_ties(start, sighted.sources, sighted.tracks, sighted.pairs, plan.processes, progress)
    suspects = suspected_marks(found.adjusted, given.points)
    bare = [Finding("no-coordinates", "doubtful", point) for point in given.without_coordinates]
    record = {
        **tie_record(sighted, found),
        "kind": "tie and control points",
        "principal_distance_from": sorted({stated_camera("", f).source for f in sighted.facts}),
        "system": {"crs": given.crs, "height": height},
        "control": {"file": control_file.name, "sigma_assumed_m": list(sigma_m), "marks": len(given.marks)},
        "unknown_marks": [f"{mark.point} in {mark.image}" for mark in unknown],
        "suspected_marks": suspects,
        **told([*bare, *found.findings, *findings_of_marks(unknown, (), suspects, found.left_out)]),
    }
    return TieBlock(found.adjusted.block, record)


def _places(facts: Sequence[ImageFacts], given: ControlMarks) -> Floats:
    """Where the images say they are; in a local system that says nothing."""
    if given.crs == "local":
        return np.full((len(facts), 3), np.nan)
    return map_places(facts, given.crs)
