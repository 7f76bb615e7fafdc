"""`photocal compare`: whether two or more calibrations are the same camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from photocal.base.console import AsJson, Language, answer, argument, option
from photocal.base.progress_bars import progress

if TYPE_CHECKING:
    from photocal.run.calibrations import Calibrated, Use


def compare(
    calibrations: Annotated[
        list[Path],
        argument(
            "One TOML file of [[camera]] entries; or certificates, run or work folders, or projects.",
            metavar="CALIBRATION",
        ),
    ],
    picture: Annotated[
        Path | None, option("Draw the matrices of all pairs (.png, .svg, .pdf).", "--picture")
    ] = None,
    curves: Annotated[
        Path | None,
        option("Draw distortion profiles, parameters over the calibrations, and vectors.", "--curves"),
    ] = None,
    parameters: Annotated[
        Path | None,
        option("Draw all parameters over the calibrations, principal points, profiles without K3, pairs."),
    ] = None,
    exchange: Annotated[
        bool,
        option(
            "Apply camera and mounting of each flight to every other one; test at its check points.",
            "--exchange",
        ),
    ] = False,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Compare calibrations: misclosure, zero rotation, rotation and single photo resection of every pair.

    [[camera]] as in block.toml: id, model, unit, size_px, pitch_mm, parameters, and optionally sigma
    (parameter = value), correlation (names, matrix), reference_radius, affinity, affinity_form; model "pix4d"
    takes f, Px, Py, R1, R2, R3, T1, T2 in mm. [comparison] sets grid_step_px, thresholds_px, terrain
    (height_m, relief_m), terrains_each and seed. [[published]] gives printed figures to follow: method,
    definition, tolerance_px, values = [[first, second, px], ...].

    At the end, two calibrations are tested for equality as parameter vectors, d' (S1 + S2)^-1 d with their
    full covariances, against chi-squared. The same test is made for the effect of the difference in the
    image, after the exterior orientation has absorbed what it can. Differences without effect in the image
    do not count. From three calibrations on, both tests are also made for all together, about their mean.
    --json has them as `joint`.

    Certificates, runs and projects give their calibrations with all sigmas and correlations, in the order of
    time: stability of one camera over several flights. From three on, the variance between flights and the
    uncertainty of a future use are given; for certificates with temperatures also c against temperature and
    time.

    Example: `photocal compare configs/studies/canon-elph/calibrations.toml --picture pairs.png`, or
    `photocal compare MAY.toml JUNE.toml --exchange`
    """
    from photocal.analysis.stability.camera_file import read_camera_file
    from photocal.analysis.stability.compared import compare_cameras
    from photocal.analysis.stability.repeatability import compared_heads, heads_text, repeatability_text
    from photocal.base.arrays import as_plain
    from photocal.base.files import picture_kind
    from photocal.findings.texts import catalogue, spoken
    from photocal.run.calibrations import cameras_of, exchanged, repeated, uses_text

    for path in (picture, curves, parameters):
        if path is not None:
            picture_kind(path)
    say = catalogue(spoken(language))
    flights = _flights(calibrations, exchange=exchange)
    asked = cameras_of(flights) if flights else read_camera_file(calibrations[0])
    how = asked.comparison
    count = len(asked.calibrations) * (len(asked.calibrations) - 1) // 2
    with progress("comparing pairs", count) as advance:
        compared = compare_cameras(asked, lambda: advance(1))
    if picture is not None:
        from photocal.analysis.stability.pictures import draw

        names = tuple(calibration.id for calibration in asked.calibrations)
        draw(compared.pairs, names, how.thresholds_px, picture, say)
    repeats = repeated(flights)
    heads = compared_heads({flight.name: flight.heads for flight in flights})
    if curves is not None:
        from photocal.analysis.stability.pictures import draw_curves

        draw_curves(asked.calibrations, curves, say)
    if parameters is not None:
        from photocal.analysis.stability.pictures import draw_parameters

        draw_parameters(asked.calibrations, compared.pairs, parameters, say)
    uses: tuple[Use, ...] = ()
    if exchange:
        with progress("using each in each", len(flights) ** 2) as advance:
            uses = exchanged(flights, lambda: advance(1))
    answer(
        as_json,
        lambda: {
            **compared.figures(),
            "repeatability": as_plain(repeats),
            "heads": [as_plain(head) | {"different": head.different} for head in heads],
            "exchange": as_plain(uses),
        },
        lambda: "\n\n".join(
            [
                compared.text(say),
                *(repeatability_text(repeat, say) for repeat in repeats.values()),
                *([heads_text(heads, say)] if heads else []),
                *([uses_text(uses, say)] if uses else []),
            ]
        ),
    )


def _flights(paths: list[Path], *, exchange: bool) -> tuple[Calibrated, ...]:
    """Find the flights that were named; none when it is a file of cameras."""
    from photocal.base.errors import ConfigurationError, InputNotFoundError
    from photocal.run.calibrations import is_camera_file, read_calibrated

    if missing := next((path for path in paths if not path.exists()), None):
        raise InputNotFoundError("no such file or folder", "check the name", where=missing)
    if not is_camera_file(paths[0]):
        return read_calibrated(paths)
    if len(paths) > 1:
        raise ConfigurationError(
            "a file of cameras is given alone", "name it, or only runs and projects", where=paths[0]
        )
    if exchange:
        raise ConfigurationError(
            "a file of cameras has no flights to exchange", "name runs or projects", where="--exchange"
        )
    return ()
