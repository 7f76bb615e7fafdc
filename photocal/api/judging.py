"""What is asked of a block, a camera or a product: hidden errors, significance, likeness, accuracy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.geometry.camera import Camera

if TYPE_CHECKING:
    from photocal.analysis.accuracy.assessment import Assessment
    from photocal.analysis.accuracy.discrepancies import Discrepancies
    from photocal.analysis.accuracy.options import JudgementOptions
    from photocal.analysis.estimates import Estimates, FTest, Proposal
    from photocal.analysis.georeferencing.comparison import BlockCheck
    from photocal.analysis.outcome import Outcome
    from photocal.analysis.stability.compared import Compared
    from photocal.block.model import Block
    from photocal.block.results.result import Result


def analyse(
    block: Block, result: Result | None = None, *, alpha: float = 0.10, threshold: float = 0.8
) -> Outcome:
    """Look for what an adjustment hides: systematic errors, insignificant and correlated parameters.

    The block is adjusted again and again with one thing changed at a time: parameters freed or left out,
    images left out, other lens models.

    Parameters
    ----------
    block
        The block that was adjusted.
    result
        Its adjustment, from which the analysis starts; without, the block is adjusted first.
    alpha
        Level of the significance tests, 0 to 1.
    threshold
        Absolute value of a correlation from which a pair is named, 0 to 1.

    Returns
    -------
    Outcome
        Findings, worst first, and for each camera significance, effects, correlations and components.

    Raises
    ------
    IllPosedError
        When the block does not determine its unknowns.
    NotConvergedError
        When its adjustment does not converge, and control that contradicts itself is not why.

    Examples
    --------
    >>> import photocal
    >>> outcome = photocal.analyse(block)
    >>> list(outcome.cameras)
    ['dcs460']
    """
    from photocal.analysis.analyse_run import analyse_block

    return analyse_block(block, result, alpha, threshold)


def significance(
    camera: Camera, *, degrees_of_freedom: float = float("inf"), alpha: float = 0.10
) -> tuple[FTest, ...]:
    """Test which parameters of a calibrated camera differ from zero.

    Parameters
    ----------
    camera
        An adjusted camera, of a result, with standard deviations and correlations.
    degrees_of_freedom
        Redundancy behind its standard deviations; infinite where they are a priori.
    alpha
        Level of the tests, 0 to 1.

    Returns
    -------
    tuple of FTest
        Tests of each parameter alone, of the usual groups, and of the radial terms one after the other.

    Raises
    ------
    IllPosedError
        When the camera has no estimated parameter with a standard deviation.

    Examples
    --------
    >>> import photocal
    >>> tests = photocal.significance(result.camera(), degrees_of_freedom=result.degrees_of_freedom)
    >>> tests[0].parameters, bool(tests[0].significant)
    (('c',), True)
    """
    from photocal.analysis.estimates import significance as tested

    return tested(_estimates(camera), degrees_of_freedom, alpha)


def components(camera: Camera) -> Proposal:
    """Propose which parameters of a calibrated camera to leave out, by principal components.

    Parameters
    ----------
    camera
        An adjusted camera, of a result, with standard deviations and correlations.

    Returns
    -------
    Proposal
        Steps of the removal, what stays, and what is recommended to leave out.

    Raises
    ------
    IllPosedError
        When the camera has no estimated parameter with a standard deviation.

    References
    ----------
    Silva: tank study, UFPR, 1995, section on the choice of additional parameters.

    Examples
    --------
    >>> import photocal
    >>> proposal = photocal.components(result.camera())
    >>> set(proposal.kept) | set(proposal.removed) == set(result.camera().free)
    True
    """
    from photocal.analysis.estimates import propose_removal

    return propose_removal(_estimates(camera))


def _estimates(calibrated: Camera) -> Estimates:
    from photocal.analysis.estimates import estimates_of

    known = None if calibrated.sigma is None else estimates_of(calibrated)
    if known is None:
        raise IllPosedError(
            "has no estimated parameter with a standard deviation", "adjust it first", where=calibrated.id
        )
    return known


def compare(calibrations: Sequence[Camera | str | Path]) -> Compared:
    """Compare calibrations pair by pair: whether two or more are the same camera.

    Parameters
    ----------
    calibrations
        Cameras of one format with different ids; or paths: one file of `[[camera]]` entries, or run folders,
        work folders, certificates and projects.

    Returns
    -------
    Compared
        Misclosure, zero rotation, rotation and single photo resection of each pair, px, with their noise.

    Raises
    ------
    ConfigurationError
        When there is only one calibration, an id occurs twice, or formats differ.
    InputNotFoundError, InputMalformedError
        When a path has no calibration.

    Examples
    --------
    >>> import dataclasses, photocal
    >>> first = result.camera()
    >>> later = dataclasses.replace(first.changed(c=1.001 * first.value("c")), id="later")
    >>> len(photocal.compare([first, later]).pairs)
    1
    """
    from photocal.analysis.stability.camera_file import CameraFile, Comparison, read_camera_file
    from photocal.analysis.stability.compared import compare_cameras
    from photocal.run.calibrations import cameras_of, is_camera_file, read_calibrated

    cameras = tuple(one for one in calibrations if isinstance(one, Camera))
    if len(cameras) == len(calibrations):
        return compare_cameras(CameraFile(cameras, (), Comparison()))
    if cameras:
        raise ConfigurationError("cameras and paths are mixed", "give one or the other")
    paths = [Path(one) for one in calibrations if not isinstance(one, Camera)]
    if len(paths) == 1 and is_camera_file(paths[0]):
        return compare_cameras(read_camera_file(paths[0]))
    return compare_cameras(cameras_of(read_calibrated(paths)))


def check(block: Block, *, standards: Sequence[str] = (), scale: float | None = None) -> BlockCheck:
    """Georeference a block three ways (direct, integrated, indirect) and judge it at its check points.

    Lever arm, boresight, time and datum errors are looked for.

    Parameters
    ----------
    block
        A block with check points, and with positions and attitudes for the direct and the integrated method.
    standards
        "decree-89817", "pec-pcd", "asprs-2024", or paths of TOML files.
    scale
        Denominator of the map scale to judge at, such as 1000; without, the exact smallest one is given.

    Returns
    -------
    BlockCheck
        Each method with residuals at control and check points (m), and what contradicts the observations.

    Raises
    ------
    IllPosedError
        When no method can be computed; the message lists the findings at the ground points.
    InputNotFoundError
        For an unknown standard.

    Examples
    --------
    >>> import photocal
    >>> judged = photocal.check(photocal.read_block("flown"), standards=["pec-pcd"], scale=1000)
    >>> len(judged.of("integrated").check.names)
    20
    """
    from photocal.analysis.accuracy.standard import Question, load_standard
    from photocal.analysis.georeferencing.comparison import check_block

    chosen = tuple(load_standard(name) for name in standards)
    return check_block(block, chosen, Question(scale_denominator=scale))


def assess(
    discrepancies: str | Path | Discrepancies | Mapping[str, Sequence[Any]],
    options: JudgementOptions | None = None,
) -> Assessment:
    """Judge a product at its check points by statistics, tests and accuracy standards.

    Parameters
    ----------
    discrepancies
        A CSV as `photocal check --discrepancies` takes it; or a DataFrame or mapping with the columns point,
        dE, dN and, where known, dh: reference minus product, m.
    options
        Standards, scale, and confidence of the tests; all shipped standards and 90 % where not given.

    Returns
    -------
    Assessment
        Moments, bias, normality and outliers of each component, and the classes by precision and by accuracy.

    Raises
    ------
    ConfigurationError
        For an invalid scale, interval or accuracy, or a table without these columns.
    InputNotFoundError, InputMalformedError
        For a file that cannot be read.

    Examples
    --------
    >>> import photocal
    >>> table = {"point": ["a", "b", "c"], "dE": [0.01, -0.02, 0.0], "dN": [0.0, 0.02, -0.01]}
    >>> judged = photocal.assess(table, photocal.JudgementOptions(standard=("pec-pcd",), scale="1:1000"))
    >>> judged.tables[0].accuracy_class
    'A'
    """
    from photocal.analysis.accuracy.assessment import assess as assessed
    from photocal.analysis.accuracy.discrepancies import Discrepancies, read_discrepancies
    from photocal.analysis.accuracy.options import JudgementOptions

    asked = options or JudgementOptions()
    if isinstance(discrepancies, str | Path):
        discrepancies = read_discrepancies(Path(discrepancies))
    if not isinstance(discrepancies, Discrepancies):
        names = tuple(map(str, _column(discrepancies, "point")))
        heights = discrepancies["dh"] if "dh" in discrepancies else np.full(len(names), np.nan)
        plane = (_column(discrepancies, "dE"), _column(discrepancies, "dN"))
        discrepancies = Discrepancies(names, -np.column_stack([*plane, heights]).astype(float))
    return assessed(discrepancies, asked.standards(), asked.question())


def _column(table: Mapping[str, Sequence[Any]], name: str) -> Sequence[Any]:
    if name not in table:
        raise ConfigurationError(f"the table has no column {name}", "give point, dE, dN and perhaps dh")
    return table[name]
