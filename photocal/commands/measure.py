"""`photocal measure`: from images to the observations of a block.

`photocal radiometry`: sharpness, resolution on the ground, vignetting and linearity of a camera.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from photocal.base.console import AsJson, answer, argument, option, progress, spread
from photocal.base.errors import ConfigurationError
from photocal.base.policy import policy
from photocal.measurement.options import MeasureOptions, RadiometryOptions


@spread
def measure(
    output: Annotated[Path, option("Block folder to write.", "-o", "--output")],
    *,
    project: Annotated[
        Path | None, argument("Project file: pictures, camera, control, marks and targets.")
    ] = None,
    images: Annotated[Path | None, option("Folder with the images.")] = None,
    options: MeasureOptions,
    as_json: Annotated[bool, option("Print measurement.json.", "--json")] = False,
) -> None:
    """Measure images, a project, a calibration board or tie points; write a block for `photocal adjust`.

    Examples: `photocal measure PROJECT.toml -o block`,
    `photocal measure --images photos --gcp gcp_list.txt --height ellipsoidal -o block`,
    `photocal measure --images photos --board 10x7 -o block`,
    `photocal measure --images lab --field 4x4_250 --distances tape.csv -o block --run run`;
    with --images alone, tie points.
    """
    if (project is None) == (images is None):
        raise ConfigurationError("what to measure is not clear", "give PROJECT.toml or --images FOLDER")
    if options.cluster:
        # Workers have working folders of their own.
        project, images = (path and path.absolute() for path in (project, images))
    record = _written(project, images or Path(), options, output)
    adjusted = []
    if options.run is not None and options.field:
        from photocal.results.adjusted import adjust_block

        adjusted = [repr(adjust_block(output, options.run))]
    answer(as_json, lambda: record, lambda: "\n".join([*_text(record, output), *adjusted]))


def _written(project: Path | None, images: Path, options: MeasureOptions, output: Path) -> dict[str, Any]:
    """Measure and write; images that cannot be oriented cost nobody the minutes of measuring."""
    from photocal.base.files import output_folder
    from photocal.measurement.measure import measure as measured_pictures
    from photocal.measurement.measurement_record import SCHEMA, MeasuredBlock
    from photocal.measurement.oriented_ties import UnorientedError
    from photocal.project import read_project

    refused = None
    try:
        measured = measured_pictures(images if project is None else read_project(project), options, progress)
    except UnorientedError as refusal:
        refused = refusal
        measured = MeasuredBlock(refusal.block, {"schema": SCHEMA, "refused": str(refusal)})
    with output_folder(output) as aside:
        measured.write(aside)
    if refused is not None:
        refused.remedy += f" (what was measured is in {output})"
        raise refused
    return measured.record


def _text(record: dict[str, Any], output: Path) -> list[str]:
    kind, next_step = record["kind"], f"block folder: {output}; next: photocal adjust {output} -o RUN"
    if kind in ("board", "field of coded targets"):
        return [*_corner_lines(record), next_step if kind == "board" else f"block folder: {output}"]
    lines = []
    if kind == "project":
        marks, plain = record["marks"], record["targets"].get("plain")
        lines = [
            f"marks by hand: {marks['by_hand']}, targets found: {marks['targets']}, used: {marks['used']}"
        ]
        if plain is not None:
            lines.append(f"uncoded targets: {plain['found']} of {plain['predicted']} predicted")
    elif kind == "tie and control points":
        control, system = record["control"], record["system"]["crs"]
        lines = [f"{control['marks']} marks of control points in {control['file']}, system {system}"]
    told_first = record["warnings"] if kind != "tie points" else []
    return [*lines, *told_first, *_tie_lines(record), next_step]


def _corner_lines(record: dict[str, Any]) -> list[str]:
    shown = record["images"]
    corners = sum(image["corners"] for image in shown)
    if record["kind"] == "board":
        unit = "" if record["board"]["square_m"] != 1.0 else " (lengths in squares: no --square-m was given)"
        head = f"{len(shown)} images show the board, {corners} corners{unit}"
    else:
        lengths = record["distances"]
        scale = f"{lengths} distances" if lengths else "no distance: the unit is free"
        head = f"{record['targets']} targets in {len(shown)} pictures, {corners} corners, {scale}"
    return [
        head,
        f"common part of a corner's sigma: {record['common_sigma_px']:.3f} px",
        *(
            f"the views determine the principal distance to {100 * ratio:.2g} % only: take more, tilted ones"
            for ratio in record["principal_distance_sigma_ratio"]
            if ratio > policy.weak_c
        ),
        *_rejected(record.get("rejected", [])),
        *_left_out(record),
    ]


def _rejected(corners: list[dict[str, str]]) -> list[str]:
    """Name the corners that do not fit to the others."""
    named = [f"{corner['point']} in {corner['image']}" for corner in corners]
    if not named:
        return []
    more = f" and {len(named) - 10} more" if len(named) > 10 else ""
    return [f"gross corners rejected, {len(named)}: {', '.join(named[:10])}{more}"]


def _left_out(record: dict[str, Any]) -> list[str]:
    return [f"left out: {entry['image']}: {entry['reason']}" for entry in record["left_out"]]


def _tie_lines(record: dict[str, Any]) -> list[str]:
    pairs, tracks = record["pairs"], record["tracks"]
    share = 100 * record["share_of_four_and_more"]
    return [
        f"{len(record['images'])} images in one block",
        f"pairs by {pairs['rule']}: {pairs['examined']} examined, {pairs['verified']} verified",
        f"tracks of features: {tracks['of_features']}; {tracks['conflicts_removed']} in conflict, not used",
        f"verified by matching: {tracks['all']}, {tracks['three_and_more_rays']} of three and more rays",
        f"points kept: {record['points']}, {share:.0f} % with four and more rays",
        f"observations rejected: {record['rejected_observations']} of {record['observations']}",
        f"sigma of an image coordinate: {record['sigma_px']:.2f} px; rms {record['rms_px']:.2f} px",
        *(record["warnings"] if record["kind"] == "tie points" else ()),
        *(f"c from: {source}" for source in record.get("principal_distance_from", ())),
        *(line for camera in record["cameras"] for line in _camera_lines(camera)),
        *_left_out(record),
    ]


def _camera_lines(camera: dict[str, Any]) -> list[str]:
    released, held = camera["released"], ", ".join(camera["held"])
    if not held:
        return []
    lines = [f"camera {camera['camera']}: {held} held; to calibrate, name them under estimate"]
    if released is None:
        return lines
    unit, digits = camera["unit"], 1 if camera["unit"] == "px" else 4
    says = (
        f"released, c becomes {released['c']:.{digits}f} +- {released['sigma']:.{digits}f} {unit} "
        f"({100 * released['change']:+.1f} %); the relief is {100 * released['relief']:.0f} % of the distance"
    )
    if not released["credible"]:
        says += ": not credible, it absorbs what the model lacks; oblique or crossed views determine c"
    return [*lines, says]


@spread
def radiometry(
    options: RadiometryOptions,
    output: Annotated[
        Path | None, option("TOML to write, [radiometry] of a certificate's particulars.", "-o", "--output")
    ] = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Measure the radiometry of a camera for the annex of its certificate.

    Grey values must be linear: raw pictures, or TIFF made without a tone curve.

    Example: `photocal radiometry --edge edge.tif --star star.tif --place 2100,1480,600 --gsd-cm 1.5`
    """
    from photocal.base.files import write_file
    from photocal.measurement.radiometry import measure_radiometry

    figures = measure_radiometry(options)
    lines = [f"{name} = {value}" for name, value in figures.items()]
    if output is not None:
        write_file(output, "\n".join(["[radiometry]", *lines, ""]))
    answer(as_json, lambda: figures, lambda: "\n".join(lines))
