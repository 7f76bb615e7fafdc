"""`photocal compare`: whether two or more calibrations are the same camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from photocal.base.arrays import as_plain
from photocal.base.console import AsJson, answer, argument, option, progress

if TYPE_CHECKING:
    from photocal.analysis.stability.camera_file import CameraFile
    from photocal.analysis.stability.comparison import Figure, Followed, Pair
    from photocal.run.calibrations import Calibrated, Use

SCHEMA = "photocal.comparison/1"


def compare(
    calibrations: Annotated[
        list[Path],
        argument("One TOML file of [[camera]] entries; or certificates, run or work folders, or projects."),
    ],
    picture: Annotated[
        Path | None, option("Draw the matrices of all pairs (.png, .svg, .pdf).", "--picture")
    ] = None,
    curves: Annotated[
        Path | None,
        option("Draw distortion profiles, parameters over the calibrations, and vectors.", "--curves"),
    ] = None,
    exchange: Annotated[
        bool,
        option("Use camera and mounting of each flight in each other, at its check points.", "--exchange"),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Compare calibrations: misclosure, zero rotation, rotation and single photo resection of every pair.

    [[camera]] as in block.toml: id, model, unit, size_px, pitch_mm, parameters, and optionally sigma
    (parameter = value), correlation (names, matrix), reference_radius, affinity, affinity_form; model "pix4d"
    takes f, Px, Py, R1, R2, R3, T1, T2 in mm. [comparison] sets grid_step_px, thresholds_px, terrain
    (height_m, relief_m), terrains_each and seed. [[published]] gives printed figures to follow: method,
    definition, tolerance_px, values = [[first, second, px], ...].

    Certificates, runs and projects give their calibrations with all sigmas and correlations, in the order of
    time: stability of one camera over several flights. From three on, the variance between flights and the
    uncertainty of a future use follow; certificates that state temperatures, c against temperature and time.

    Example: `photocal compare configs/studies/canon-elph.toml --picture pairs.png`, or
    `photocal compare MAY.toml JUNE.toml --exchange`
    """
    import numpy as np

    from photocal.analysis.stability.camera_file import read_camera_file
    from photocal.analysis.stability.comparison import compare as compare_pairs
    from photocal.analysis.stability.comparison import follow
    from photocal.analysis.stability.methods import methods, sensor_grid
    from photocal.analysis.stability.repeatability import compared_heads, heads_text, repeatability_text
    from photocal.base.files import picture_kind
    from photocal.run.calibrations import cameras_of, exchanged, repeated, uses_text

    for path in (picture, curves):
        if path is not None:
            picture_kind(path)
    flights = _flights(calibrations, exchange=exchange)
    asked = cameras_of(flights) if flights else read_camera_file(calibrations[0])
    how = asked.comparison
    pixels = sensor_grid(asked.calibrations[0].size_px, how.grid_step_px)
    chosen = methods(len(pixels), how.terrain, how.terrains_each, how.seed)
    count = len(asked.calibrations) * (len(asked.calibrations) - 1) // 2
    with progress("comparing pairs", count) as advance:
        pairs = compare_pairs(
            asked.calibrations, pixels, chosen, np.random.default_rng(how.seed), done=lambda: advance(1)
        )
    followed = follow(asked.published, pairs)
    if picture is not None:
        from photocal.analysis.stability.pictures import draw

        draw(pairs, tuple(calibration.id for calibration in asked.calibrations), how.thresholds_px, picture)
    repeats = repeated(flights)
    heads = compared_heads({flight.name: flight.heads for flight in flights})
    if curves is not None:
        from photocal.analysis.stability.pictures import draw_curves

        draw_curves(asked.calibrations, curves)
    uses: tuple[Use, ...] = ()
    if exchange:
        with progress("using each in each", len(flights) ** 2) as advance:
            uses = exchanged(flights, lambda: advance(1))
    answer(
        as_json,
        lambda: {
            **_figures(asked, len(pixels), pairs, followed),
            "repeatability": as_plain(repeats),
            "heads": [as_plain(head) | {"different": head.different} for head in heads],
            "exchange": as_plain(uses),
        },
        lambda: "\n\n".join(
            [
                _text(asked, pairs, followed),
                *(repeatability_text(repeat) for repeat in repeats.values()),
                *([heads_text(heads)] if heads else []),
                *([uses_text(uses)] if uses else []),
            ]
        ),
    )


def _flights(paths: list[Path], *, exchange: bool) -> tuple[Calibrated, ...]:
    """Find the flights that were named; none when it is a file of cameras."""
    from photocal.base.errors import ConfigurationError
    from photocal.run.calibrations import is_camera_file, read_calibrated

    if not is_camera_file(paths[0]):
        return read_calibrated(paths)
    if len(paths) > 1:
        raise ConfigurationError(
            "a file of cameras stands alone", "name it, or runs and projects only", where=paths[0]
        )
    if exchange:
        raise ConfigurationError(
            "cameras alone have no flights to be used in", "name runs or projects", where="--exchange"
        )
    return ()


def _figures(
    asked: CameraFile, points: int, pairs: tuple[Pair, ...], followed: tuple[Followed, ...]
) -> dict[str, Any]:
    from photocal.analysis.stability.comparison import likeness, sentences

    how = asked.comparison
    return {
        "schema": SCHEMA,
        "cameras": [calibration.id for calibration in asked.calibrations],
        "grid": {"points": points, "step_px": how.grid_step_px},
        "thresholds_px": how.thresholds_px,
        "terrains": [terrain.model_dump() for terrain in how.terrain],
        "terrains_each": how.terrains_each,
        "seed": how.seed,
        "pairs": [
            {
                "first": pair.first,
                "second": pair.second,
                "figures": [
                    as_plain(figure)
                    | {"different": figure.different, "within_px": likeness(figure, how.thresholds_px)}
                    for figure in pair.figures
                ],
            }
            for pair in pairs
        ],
        "published": [as_plain(row) | {"follows": row.follows} for row in followed],
        "findings": list(sentences(pairs, how.thresholds_px, followed)),
    }


def _text(asked: CameraFile, pairs: tuple[Pair, ...], followed: tuple[Followed, ...]) -> str:
    from photocal.analysis.stability.comparison import sentences

    names = tuple(calibration.id for calibration in asked.calibrations)
    blocks = [_matrix(pairs, names, k) for k in range(len(pairs[0].figures))]
    if any(figure.sigma_px is not None for pair in pairs for figure in pair.figures):
        blocks.append("value +- its standard deviation, px; * differs beyond the noise of both (95 %)")
    return "\n\n".join([*blocks, "\n".join(sentences(pairs, asked.comparison.thresholds_px, followed))])


def _matrix(pairs: tuple[Pair, ...], names: tuple[str, ...], which: int) -> str:
    from photocal.findings.document import Section, table, text

    cells = {(pair.first, pair.second): _cell(pair.figures[which]) for pair in pairs}
    kind = pairs[0].figures[which]
    rows = [(second, *(cells.get((first, second), "") for first in names[:-1])) for second in names[1:]]
    return text([Section("", (table(f"{kind.method}, {kind.definition}, px", ["", *names[:-1]], rows),))])


def _cell(figure: Figure) -> str:
    if figure.sigma_px is None:
        return f"{figure.value_px:.2f} "
    return f"{figure.value_px:.2f}+-{figure.sigma_px:.2f}{'*' if figure.different else ' '}"
