"""The command `photocal`: a list of its commands, each in a module of its own."""

from __future__ import annotations

from acquire.console import application
from acquire.console import run as run_application
from photocal.commands import (
    adjust,
    adopt,
    analyse,
    certificate,
    check,
    compare,
    debrief,
    doctor,
    export,
    exposures,
    fetch_grids,
    flown,
    keys,
    mark,
    measure,
    new,
    ortho,
    plan,
    ppk,
    run,
    sign,
    survey,
    targets,
    verify,
    volume,
)

app = application("From flight log, images and control points to a calibrated camera and its certificate.")
app.command()(new.new)
app.command()(run.run)
app.command()(debrief.debrief)
app.command()(mark.mark)
app.command()(measure.measure)
app.command()(targets.targets)
app.command()(adjust.adjust)
app.command()(certificate.certificate)
app.command()(verify.verify)
app.command()(keys.keys)
app.command()(sign.sign)
app.command()(doctor.doctor)
app.command("fetch-grids")(fetch_grids.fetch_grids)
app.command()(analyse.analyse)
app.command()(compare.compare)
app.command()(check.check)
app.command()(plan.plan)
app.command()(flown.flown)
app.command()(ppk.ppk)
app.command()(exposures.exposures)
app.command()(survey.survey)
app.command()(adopt.adopt)
app.command()(export.export)
app.command()(volume.volume)
app.command()(ortho.ortho)


def main() -> None:
    """Run the command line."""
    run_application(app)
