"""Images and their tie points as a block, alone or with marked control points."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from photocal.base.errors import ConfigurationError
from photocal.base.progress import Progress
from photocal.base.workers import one_crew
from photocal.block.model import Block
from photocal.findings.finding import Finding
from photocal.findings.texts import as_record
from photocal.measurement import marks
from photocal.measurement.block_files import Measured
from photocal.measurement.maker_camera import NO_LENS, GivenLens, stated_camera
from photocal.measurement.match_images import MatchingPlan
from photocal.measurement.measure_ties import Sighted, position_figures, sight, stated_footprints, tie_record
from photocal.measurement.oriented_ties import FEWEST_CONTROL, Oriented, orient_ties
from photocal.measurement.position_files import local_places, map_places
from photocal.measurement.project_block import OTHER_SURFACE_M, findings_of_marks, suspected_marks
from photocal.measurement.start_block import position_sigma, start_block
from photocal.measurement.tie_block import marked_control


@dataclass(frozen=True)
class GivenControl:
    """A file of marked control points, and what it does not say itself.

    sigma_m: in plane and height, of points without.
    crs: reference system in place of the file's, or empty.
    height: kind of the heights.
    """

    path: Path
    sigma_m: tuple[float, float]
    crs: str
    height: str

    def read(self, sizes: dict[str, tuple[int, int]]) -> marks.ControlMarks:
        """Points and marks, in a map system or local, as the images of these sizes show them."""
        given = marks.read_control_marks(self.path, self.sigma_m, sizes)
        return replace(given, crs=self.crs) if self.crs else marks.in_map_system(given)

    def require_heights(self) -> None:
        """Refuse a file of which nobody says what its heights are."""
        given = marks.read_control_marks(self.path, self.sigma_m, {})
        if given.crs != "local" and self.height not in ("ellipsoidal", "orthometric"):
            raise ConfigurationError(
                "does not say what its heights are",
                "give --height ellipsoidal or --height orthometric",
                where=self.path,
            )


@one_crew()
def measure_images(
    paths: Sequence[Path],
    name: str,
    plan: MatchingPlan,
    progress: Progress,
    lens: GivenLens = NO_LENS,
    control: GivenControl | None = None,
) -> Measured:
    """Measure tie points in images, join them with marked control points, and make their block.

    raises PhotocalError: when the file or too few images can be read, or the images are not oriented.
    """
    if control is not None:
        # What is wrong with the file is told before the images are looked at.
        control.require_heights()
    sighted = sight(paths, plan, progress, stated_footprints, lens.of)
    principal = {"principal_distance_from": sorted({stated_camera("", f).source for f in sighted.facts})}
    if control is None:
        places, origin = local_places(sighted.facts)
        oriented = _oriented(start_block(sighted.facts, places, name), sighted, plan, progress)
        at = dict(zip(("latitude_deg", "longitude_deg", "height_m"), origin, strict=True))
        record = {
            **tie_record(sighted, oriented),
            "kind": "tie points",
            **as_record(oriented.findings),
            **principal,
            "positions": position_figures(sighted.facts, position_sigma(sighted.facts)),
            "origin": at if np.isfinite(origin[0]) else None,
        }
        return Measured(oriented.adjusted.block, record)
    sizes = {image.name: image.size_px for image in sighted.facts}
    given = control.read(sizes)
    local = given.crs == "local"
    # Where the images say they are; in a local system that says nothing.
    places = np.full((len(sighted.facts), 3), np.nan) if local else map_places(sighted.facts, given.crs)
    start = replace(
        start_block(sighted.facts, places, name),
        frame=given.crs,
        height="" if local else control.height,
        datum="control",
        points=given.points,
    )
    start, unknown = marks.with_marks(start, marks.named_after(given.marks, sizes))
    if len(marked_control(start)) >= FEWEST_CONTROL:
        known = np.isfinite(start.images.sigma[:, 5])
        start.images.sigma[known, 5] = OTHER_SURFACE_M
    oriented = _oriented(start, sighted, plan, progress)
    suspects = suspected_marks(oriented.adjusted, given.points)
    bare = [Finding("no-coordinates", "doubtful", point) for point in given.without_coordinates]
    file = {"file": control.path.name, "sigma_assumed_m": list(control.sigma_m), "marks": len(given.marks)}
    record = {
        **tie_record(sighted, oriented),
        "kind": "tie and control points",
        **principal,
        "system": {"crs": given.crs, "height": control.height},
        "control": file,
        "unknown_marks": [f"{mark.point} in {mark.image}" for mark in unknown],
        "suspected_marks": suspects,
        **as_record(
            [
                *bare,
                *oriented.findings,
                *findings_of_marks(unknown, (), suspects, (*sighted.left_out, *oriented.left_out)),
            ]
        ),
    }
    return Measured(oriented.adjusted.block, record)


def _oriented(start: Block, sighted: Sighted, plan: MatchingPlan, progress: Progress) -> Oriented:
    return orient_ties(start, sighted.sources, sighted.tracks, sighted.pairs, plan.processes, progress)
