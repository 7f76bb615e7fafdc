"""The command `photocal`: a list of its commands; the module of each is imported when it is asked for."""

from typing import TYPE_CHECKING

from photocal.base.console import application
from photocal.base.console import run as run_application

if TYPE_CHECKING:
    from photocal.base.sentences import Texts

COMMANDS = {
    "new": "photocal.commands.project:new",
    "run": "photocal.commands.project:run",
    "debrief": "photocal.commands.project:debrief",
    "desk": "photocal.commands.project:desk",
    "mark": "photocal.commands.mark:mark",
    "measure": "photocal.commands.measure:measure",
    "targets": "photocal.commands.mark:targets",
    "adjust": "photocal.commands.calibration:adjust",
    "certificate": "photocal.commands.calibration:certificate",
    "verify": "photocal.commands.verify:verify",
    "keys": "photocal.commands.verify:keys",
    "sign": "photocal.commands.verify:sign",
    "doctor": "photocal.commands.doctor:doctor",
    "fetch-grids": "photocal.commands.doctor:fetch_grids",
    "analyse": "photocal.commands.calibration:analyse",
    "compare": "photocal.commands.compare:compare",
    "check": "photocal.commands.check:check",
    "plan": "photocal.commands.plan:plan",
    "plan-network": "photocal.commands.plan:plan_network",
    "flown": "photocal.commands.plan:flown",
    "forms": "photocal.commands.calibration:forms",
    "radiometry": "photocal.commands.measure:radiometry",
    "ppk": "photocal.commands.navigation:ppk",
    "exposures": "photocal.commands.navigation:exposures",
    "survey": "photocal.commands.navigation:survey",
    "localise": "photocal.commands.navigation:localise",
    "rover-test": "photocal.commands.check:rover_test",
    "adopt": "photocal.commands.project:adopt",
    "export": "photocal.commands.export:export",
    "volume": "photocal.commands.products:volume",
    "ortho": "photocal.commands.products:ortho",
    "contours": "photocal.commands.products:contours",
    "study": "photocal.commands.study:study",
}
app = application(
    "From flight log, images and control points to a calibrated camera and its certificate.", COMMANDS
)


def main() -> None:
    """Run the command line."""
    run_application(app, texts, "photocal.commands")


def texts(language: str) -> "Texts":
    """Return all texts of a language, see `photocal.findings.texts.catalogue`."""
    from photocal.findings.texts import catalogue

    return catalogue(language)
