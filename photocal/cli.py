"""The command `photocal`: a list of its commands, each in a module of its own."""

from photocal.base.console import application
from photocal.base.console import run as run_application
from photocal.commands import (
    calibration,
    check,
    compare,
    desk,
    doctor,
    export,
    forms,
    mark,
    measure,
    navigation,
    plan,
    products,
    project,
    radiometry,
    rover,
    study,
    verify,
)

app = application("From flight log, images and control points to a calibrated camera and its certificate.")
app.command()(project.new)
app.command()(project.run)
app.command()(project.debrief)
app.command()(desk.desk)
app.command()(mark.mark)
app.command()(measure.measure)
app.command()(mark.targets)
app.command()(calibration.adjust)
app.command()(calibration.certificate)
app.command()(verify.verify)
app.command()(verify.keys)
app.command()(verify.sign)
app.command()(doctor.doctor)
app.command("fetch-grids")(doctor.fetch_grids)
app.command()(calibration.analyse)
app.command()(compare.compare)
app.command()(check.check)
app.command()(plan.plan)
app.command("plan-network")(plan.plan_network)
app.command()(plan.flown)
app.command()(forms.forms)
app.command()(radiometry.radiometry)
app.command()(navigation.ppk)
app.command()(navigation.exposures)
app.command()(navigation.survey)
app.command()(navigation.localise)
app.command("rover-test")(rover.rover_test)
app.command()(project.adopt)
app.command()(export.export)
app.command()(products.volume)
app.command()(products.ortho)
app.command()(products.contours)
app.command()(study.study)


def main() -> None:
    """Run the command line."""
    run_application(app)
