"""The step from pictures to a block: of a project, of a folder, of a board or a field of coded targets."""

from functools import partial
from pathlib import Path

from photocal.base.errors import ConfigurationError
from photocal.base.operating_system import cache_folder
from photocal.base.progress import Progress, quiet
from photocal.base.workers import Cluster
from photocal.measurement.image_file import list_images
from photocal.measurement.maker_camera import with_lens
from photocal.measurement.markers import parse_board
from photocal.measurement.match_images import MatchingPlan
from photocal.measurement.measurement_record import MeasuredBlock
from photocal.measurement.options import MeasureOptions
from photocal.measurement.orientation import of_exposures
from photocal.measurement.picture_block import measure_images, measure_project
from photocal.measurement.target_block import measure_board, measure_field
from photocal.project import Project


def measure(
    pictures: Project | Path | str, options: MeasureOptions | None = None, progress: Progress = quiet
) -> MeasuredBlock:
    """Measure pictures, and make the block that `photocal.adjust` takes.

    Parameters
    ----------
    pictures
        A project that was read, or the folder of the pictures.
    options
        What is measured in a folder (tie points, with marked control, a board, a field of coded targets), and
        with which means. A project names its own control and targets.
    progress
        Told how far the work is.

    Returns
    -------
    MeasuredBlock
        The block, and the record of how it was measured (`measurement.json`).

    Raises
    ------
    ConfigurationError
        When options do not go with what is measured.
    PhotocalError
        When too few pictures can be read, show the targets, or are oriented.
    """
    options = options or MeasureOptions()
    if isinstance(pictures, Project):
        if options.board or options.gcp is not None:
            raise ConfigurationError("a project names its own control", "give --images with --board or --gcp")
        # What `photocal exposures` or `photocal run` left in the work folder: good to start from.
        folder = pictures.output / "exposures"
        exposures = of_exposures(pictures, folder) if (folder / "images.csv").exists() else None
        plan = _plan(options, pictures.picture_folder)
        return measure_project(pictures, exposures, plan, progress, options.marks)
    if options.marks:
        raise ConfigurationError(
            "--marks has no coordinates of its points",
            "give PROJECT.toml, whose control table has them, or --gcp with both",
        )
    folder = Path(pictures)
    paths, name = list_images(folder), folder.resolve().name
    if options.field:
        cache = (options.cache or cache_folder()).resolve()
        lens = partial(with_lens, c_px=options.c_px, focal_mm=options.focal_mm)
        return measure_field(paths, options.field, options.distances, name, lens, cache, progress)
    if options.board:
        board = parse_board(options.board, options.square_m, options.charuco)
        return measure_board(paths, board, name, progress)
    return measure_images(paths, name, _plan(options, folder), progress, options)


def _plan(options: MeasureOptions, images: Path) -> MatchingPlan:
    usual = MatchingPlan()
    cache = (options.cache or usual.cache).resolve()
    if not options.cluster:
        return MatchingPlan(cache, options.workers or usual.processes)
    cluster = Cluster(options.cluster)
    cluster.require_shared(images, cache)
    return MatchingPlan(cache, cluster)
