"""Where a project may write: into a folder of its own."""

from pathlib import Path

from photocal.base.errors import ConfigurationError
from photocal.block.project import Project
from photocal.run.stage import made_in

STAGES = (
    "control", "ppk", "exposures", "measurements", "block", "calibration", "flown", "georeferencing",
    "analysis", "certificate",
)  # fmt: skip
_REMEDY = 'name a folder of its own, such as output = "work"'


def check_output(project: Project) -> str:
    """Refuse a work folder in which results would mix with what is there.

    returns: what to tell of a folder that lies outside of the project; empty for one inside.
    raises ConfigurationError: for a root, the home folder, a folder that holds the project or its pictures,
        one within a block that is taken over, and one with files of others that no run has worked in.
    """
    output, home = project.output.resolve(), project.path.resolve().parent
    wrong = ConfigurationError.at(project.path)
    said = f"output = {str(project.output)!r}"
    if output == output.parent:
        raise wrong(f"{said} is the root of a disk", _REMEDY)
    if output == _home():
        raise wrong(f"{said} is your home folder", _REMEDY)
    if home.is_relative_to(output):
        raise wrong(f"{said} holds the project itself", _REMEDY)
    images, given = project.contents.images, project.contents.measurements
    if images is not None and images.folder is not None and images.folder.resolve().is_relative_to(output):
        raise wrong(f"{said} holds the pictures", _REMEDY)
    block = None if given is None or given.block is None else given.block.resolve()
    if block is not None and (block.is_relative_to(output) or output.is_relative_to(block)):
        raise wrong(f"{said} and the block folder: one contains the other", _REMEDY)
    if foreign := _foreign(output):
        raise wrong(f"{said} contains files that no run has written, first {foreign}", _REMEDY)
    return "" if output.is_relative_to(home) else f"the results go outside the project, into {output}"


def _home() -> Path | None:
    try:
        return Path.home().resolve()
    except RuntimeError:
        return None


def _foreign(output: Path) -> str:
    """The first file or folder of somebody else in a folder in which nothing of ours has worked yet."""
    if not output.is_dir() or made_in(output).is_dir() or (output / ".lock").exists():
        return ""
    names = sorted(path.name for path in output.iterdir() if not path.name.startswith("."))
    return next((name for name in names if name not in STAGES), "")
