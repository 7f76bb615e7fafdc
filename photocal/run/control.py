"""Stage `control`: control and its marks opened, counted and compared with the pictures before any work."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from photocal.base.errors import PhotocalError
from photocal.base.files import write_json
from photocal.base.progress import Progress
from photocal.block.project import Project
from photocal.findings.finding import Finding
from photocal.run.stage import Stage

SCHEMA = "photocal.control/1"
FIGURES = "control.json"


def control_stage(project: Project) -> Stage | None:
    """Describe the stage; None for a project without control, or without pictures that show it."""
    control, images = project.control, project.contents.images
    if control.points is None or images is None or images.folder is None:
        return None
    inputs = {"control points": control.points}
    if control.marks is not None and control.marks.exists():
        inputs["marks"] = control.marks

    def make(folder: Path, _: Progress) -> None:
        """Make the file of the stage."""
        write_json(folder / FIGURES, control_figures(project))

    settings = {"crs": project.crs, "pictures": sorted(_pictures(project))}
    return Stage("control", "the control", make, inputs, settings)


def _pictures(project: Project) -> Mapping[str, Path]:
    from photocal.measurement.image_file import list_images

    return {path.name: path for path in list_images(project.picture_folder)}


def control_figures(project: Project) -> dict[str, Any]:
    """Count points and marks, and name what of them cannot be used."""
    from photocal.findings.texts import as_record, catalogue, plain, sentence
    from photocal.measurement.control_review import stray_points
    from photocal.measurement.image_facts import read_facts
    from photocal.measurement.mark_frames import settle_marks
    from photocal.measurement.marks import read_marks
    from photocal.measurement.picture_block import control_points

    points, file, pictures = control_points(project), project.control.marks, _pictures(project)
    marks = read_marks(file) if file is not None and file.exists() else ()
    facts = []
    for name in dict.fromkeys(mark.image for mark in marks if mark.image in pictures):
        try:
            facts.append(read_facts(pictures[name]))
        except PhotocalError:
            # Its marks are named as those of a picture that cannot be used.
            continue
    used, frame, unused, findings = settle_marks(marks, points.names, facts, pictures)
    if file is not None and not file.exists() and not project.control.targets and len(points.names):
        findings.append(Finding("marks-absent", "doubtful", file.name))
    strays = stray_points(points, project.crs).values()
    lost, say = [finding for _, finding in unused], catalogue("en")
    return {
        "schema": SCHEMA,
        "points": {role: int(points.of_role(role).sum()) for role in ("control", "check", "tie")},
        "marks": {
            "read": len(marks),
            "used": len(used),
            "not_used": [sentence(finding, say, plain) for finding in lost],
            "made_in": str(frame),
        },
        **as_record([*strays, *findings, *lost]),
    }
