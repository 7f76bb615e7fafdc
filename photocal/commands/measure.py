"""`photocal measure`: from images to the observations of a block.

`photocal radiometry`: sharpness, resolution on the ground, vignetting and linearity of a camera.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from photocal.base.console import AsJson, Language, answer, argument, option, spread
from photocal.base.errors import ConfigurationError
from photocal.base.policy import policy
from photocal.base.progress_bars import progress
from photocal.measurement.options import MeasureOptions, RadiometryOptions

if TYPE_CHECKING:
    from photocal.findings.texts import Catalogue


@spread
def measure(
    output: Annotated[Path, option("Block folder to write.", "-o", "--output")],
    *,
    project: Annotated[
        Path | None,
        argument("Project file: pictures, camera, control, marks and targets.", metavar="PROJECT"),
    ] = None,
    images: Annotated[Path | None, option("Folder with the images.")] = None,
    options: MeasureOptions,
    language: Language = "",
    as_json: Annotated[bool, option("Print measurement.json.", "--json")] = False,
) -> None:
    """Measure images, a project, a calibration board or tie points; write a block for `photocal adjust`.

    Examples: `photocal measure PROJECT.toml -o block`,
    `photocal measure --images photos --gcp gcp_list.txt --height ellipsoidal -o block`,
    `photocal measure --images photos --board 10x7 -o block`,
    `photocal measure --images lab --field 4x4_250 --distances tape.csv -o block --run run`;
    with --images alone, tie points.
    """
    from photocal.findings.texts import catalogue, spoken

    say = catalogue(spoken(language))
    if (project is None) == (images is None):
        raise ConfigurationError("what to measure is not clear", "give PROJECT.toml or --images FOLDER")
    if options.cluster:
        # Workers have working folders of their own.
        project, images = (path and path.absolute() for path in (project, images))
    record = _written(project, images or Path(), options, output)
    adjusted = []
    if options.run is not None and options.field:
        from photocal.block.results.adjusted import adjust_block

        adjusted = [adjust_block(output, options.run).text(say)]
    answer(as_json, lambda: record, lambda: "\n".join([*_text(record, output, say), *adjusted]))


def _written(project: Path | None, images: Path, options: MeasureOptions, output: Path) -> dict[str, Any]:
    """Measure and write; images that cannot be oriented cost nobody the minutes of measuring."""
    from photocal.base.files import output_folder
    from photocal.block.project import read_project
    from photocal.measurement.measurement_record import SCHEMA, MeasuredBlock
    from photocal.measurement.oriented_ties import UnorientedError
    from photocal.measurement.picture_block import measure as measured_pictures

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


def _text(record: dict[str, Any], output: Path, say: Catalogue) -> list[str]:
    kind, next_step = record["kind"], say("measured.next", output=output)
    if kind in ("board", "field of coded targets"):
        last = next_step if kind == "board" else say("measured.folder", output=output)
        return [*_corner_lines(record, say), last]
    lines = []
    if kind == "project":
        marks, plain = record["marks"], record["targets"].get("plain")
        counts = {name: marks[name] for name in ("by_hand", "targets", "used")}
        lines = [say("measured.marks", **counts)]
        if plain is not None:
            found = {name: plain[name] for name in ("found", "predicted")}
            lines.append(say("measured.plain", **found))
    elif kind == "tie and control points":
        control, system = record["control"], record["system"]["crs"]
        lines = [say("measured.control", marks=control["marks"], file=control["file"], system=system)]
    first = _warnings(record, say) if kind != "tie points" else []
    return [*lines, *first, *_tie_lines(record, say), next_step]


def _warnings(record: dict[str, Any], say: Catalogue) -> list[str]:
    """Say what was found, but for what is small."""
    from photocal.findings.texts import finding_text, findings_of, plain

    found = findings_of(record["findings"], "measurement.json")
    return [finding_text(finding, say, plain) for finding in found if not finding.small]


def _corner_lines(record: dict[str, Any], say: Catalogue) -> list[str]:
    shown = record["images"]
    counts = {"n": len(shown), "corners": sum(image["corners"] for image in shown)}
    if record["kind"] == "board":
        unit = "" if record["board"]["square_m"] != 1.0 else say("measured.squares")
        head = say("measured.board", **counts, unit=unit)
    else:
        lengths = record["distances"]
        scale = say("measured.distances", n=lengths) if lengths else say("measured.no_distance")
        head = say("measured.field", **counts, targets=record["targets"], scale=scale)
    return [
        head,
        say.told("measured.common", sigma=record["common_sigma_px"]),
        *(
            say.told("measured.weak_c", percent=100 * ratio)
            for ratio in record["principal_distance_sigma_ratio"]
            if ratio > policy.weak_c
        ),
        *_rejected(record.get("rejected", []), say),
        *_left_out(record, say),
    ]


def _rejected(corners: list[dict[str, str]], say: Catalogue) -> list[str]:
    """Name the corners that do not fit to the others."""
    named = [say("measured.corner", point=corner["point"], image=corner["image"]) for corner in corners]
    if not named:
        return []
    more = say("join.more", count=len(named) - 10) if len(named) > 10 else ""
    return [say("measured.rejected", n=len(named), names=", ".join(named[:10]) + more)]


def _left_out(record: dict[str, Any], say: Catalogue) -> list[str]:
    return [
        say(
            "measured.left_out",
            image=entry["image"],
            reason="; ".join(map(say.stored, entry["reason"].split("; "))),
        )
        for entry in record["left_out"]
    ]


def _tie_lines(record: dict[str, Any], say: Catalogue) -> list[str]:
    pairs, tracks = record["pairs"], record["tracks"]
    share, of = 100 * record["share_of_four_and_more"], record["observations"]
    found = {name: pairs[name] for name in ("examined", "verified")}
    more = {"n": tracks["all"], "more": tracks["three_and_more_rays"]}
    conflicts = {"n": tracks["of_features"], "conflicts": tracks["conflicts_removed"]}
    return [
        say("measured.images", n=len(record["images"])),
        say("measured.pairs", **found, rule=say.stored(pairs["rule"])),
        say("measured.features", **conflicts),
        say("measured.tracks", **more),
        say.told("measured.points", n=record["points"], share=share),
        say("measured.rays", rejected=record["rejected_observations"], n=of),
        say.told("measured.sigma", sigma=record["sigma_px"], rms=record["rms_px"]),
        *(_warnings(record, say) if record["kind"] == "tie points" else ()),
        *(
            say("measured.c_from", source=say.stored(source))
            for source in record.get("principal_distance_from", ())
        ),
        *(line for camera in record["cameras"] for line in _camera_lines(camera, say)),
        *_left_out(record, say),
    ]


def _camera_lines(camera: dict[str, Any], say: Catalogue) -> list[str]:
    released, held = camera["released"], ", ".join(camera["held"])
    if not held:
        return []
    lines = [say("measured.held", camera=camera["camera"], names=held)]
    if released is None:
        return lines
    form = ".1f" if camera["unit"] == "px" else ".4f"
    both = {name: say.row([released[name]], form) for name in ("c", "sigma")}
    parts = {name: 100 * released[name] for name in ("change", "relief")}
    says = say.told("measured.released", **both, **parts, unit=camera["unit"])
    return [*lines, says if released["credible"] else says + say("measured.not_credible")]


@spread
def radiometry(
    options: RadiometryOptions,
    output: Annotated[
        Path | None, option("TOML to write, [radiometry] of a certificate's particulars.", "-o", "--output")
    ] = None,
    *,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Measure the radiometry of a camera for the annex of its certificate.

    Grey values must be linear: TIFF made from raw pictures without a tone curve, not JPEG.

    Example: `photocal radiometry --edge edge.tif --star star.tif --place 2100,1480,600 --gsd-cm 1.5`
    """
    from photocal.base.files import write_file
    from photocal.findings.texts import catalogue, spoken
    from photocal.measurement.radiometry import measure_radiometry
    from photocal.report.required_sections import radiometry_rows

    say = catalogue(spoken(language))
    figures = measure_radiometry(options)
    if output is not None:
        lines = (f"{name} = {value}" for name, value in figures.items())
        write_file(output, "\n".join(["[radiometry]", *lines, ""]))
    answer(as_json, lambda: figures, lambda: "\n".join(map(": ".join, radiometry_rows(figures, say))))
