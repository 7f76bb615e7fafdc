"""The command `photocal`: a list of its commands; the module of each is imported when it is asked for."""

from photocal.base.console import Listed, application
from photocal.base.console import run as run_application

COMMANDS = {
    "new": Listed(
        "photocal.commands.project:new",
        "Inspect a folder and write its project.toml; list what was found and what is missing.",
    ),
    "run": Listed(
        "photocal.commands.project:run",
        "Process a flight: PPK, exposures, image points, calibration, check points, analysis, certificate.",
    ),
    "debrief": Listed(
        "photocal.commands.project:debrief",
        "Judge a flight before the crew drives home: complete, to be checked, or to be flown again.",
    ),
    "desk": Listed(
        "photocal.commands.project:desk",
        "Open a window on a folder: choose, check, run, look, certify, on a local web page.",
    ),
    "mark": Listed(
        "photocal.commands.mark:mark",
        "Mark control and check points in the images on a local web page; every mark is saved at once.",
    ),
    "measure": Listed(
        "photocal.commands.measure:measure",
        "Measure images, a project, a calibration board or tie points; write a block for `photocal adjust`.",
    ),
    "targets": Listed(
        "photocal.commands.mark:targets",
        "Write target sheets as PDF, true to scale, for all targets that `photocal measure` reads.",
    ),
    "adjust": Listed(
        "photocal.commands.calibration:adjust",
        "Adjust a block: camera, orientations and points with their complete statistics.",
    ),
    "certificate": Listed(
        "photocal.commands.calibration:certificate",
        "Write the certificate of a calibration: HTML page, PDF and JSON.",
    ),
    "verify": Listed(
        "photocal.commands.verify:verify",
        "Repeat a certificate from its inputs, compare every figure and page, and judge its signature.",
    ),
    "keys": Listed(
        "photocal.commands.verify:keys",
        "Show the known keys by their fingerprints, make one, or list the journal of issued certificates.",
    ),
    "sign": Listed(
        "photocal.commands.verify:sign",
        "Sign a certificate with the key of `photocal keys`: every file of its folder.",
    ),
    "doctor": Listed(
        "photocal.commands.doctor:doctor",
        "Check whether this machine is ready to record and to process.",
    ),
    "fetch-grids": Listed(
        "photocal.commands.doctor:fetch_grids",
        "Fetch the grids that a reference system needs, so that it can be used without a network.",
    ),
    "analyse": Listed(
        "photocal.commands.calibration:analyse",
        "Analyse a calibration: a verdict, hidden errors worst first, significance, correlations, method.",
    ),
    "compare": Listed(
        "photocal.commands.compare:compare",
        "Compare calibrations: misclosure, zero rotation, rotation and single photo resection of every pair.",
    ),
    "check": Listed(
        "photocal.commands.check:check",
        "Judge a block or a product at its check points: statistics, tests and accuracy classes.",
    ),
    "plan": Listed(
        "photocal.commands.plan:plan",
        "Plan a photo flight: height, overlaps, strips, expected precision, control, mission.",
    ),
    "plan-network": Listed(
        "photocal.commands.plan:plan_network",
        "Predict the precision of a close-range network before the photos are taken.",
    ),
    "flown": Listed(
        "photocal.commands.plan:flown",
        "Measure a flown block: height, ground sampling, tilt, real overlaps, rays, gaps, motion blur.",
    ),
    "forms": Listed(
        "photocal.commands.calibration:forms",
        "Write sheets to print: GNSS stations, flight log, targets, laboratory, test of a rover.",
    ),
    "radiometry": Listed(
        "photocal.commands.measure:radiometry",
        "Measure the radiometry of a camera for the annex of its certificate.",
    ),
    "ppk": Listed(
        "photocal.commands.navigation:ppk",
        "Compute the trajectory of a rover from raw observations of rover and base.",
    ),
    "exposures": Listed(
        "photocal.commands.navigation:exposures",
        "Compute position and attitude of every exposure, with covariances, and check them.",
    ),
    "survey": Listed(
        "photocal.commands.navigation:survey",
        "Compute static baselines, adjust them as a network and write points with full covariances.",
    ),
    "localise": Listed(
        "photocal.commands.navigation:localise",
        "Calibrate a site: tie a local system to a map system by the points that both tables name.",
    ),
    "rover-test": Listed(
        "photocal.commands.check:rover_test",
        "Test a GNSS rover (RTK) in the field after ISO 17123-8, simplified or full.",
    ),
    "adopt": Listed(
        "photocal.commands.project:adopt",
        "Adjust a project of Pix4D, Metashape, ODM, OpenSfM, COLMAP or MicMac again and compare.",
    ),
    "export": Listed(
        "photocal.commands.export:export",
        "Export cameras, orientations, points and measurements; report the cost of a changed camera model.",
    ),
    "volume": Listed(
        "photocal.commands.products:volume",
        "Volume of a tank, round or of any closed shape, with its standard deviation.",
    ),
    "ortho": Listed(
        "photocal.commands.products:ortho",
        "Make an orthophoto: every cell takes its grey value from the image that sees it best from above.",
    ),
    "contours": Listed(
        "photocal.commands.products:contours",
        "Write the contours of a terrain model for CAD (DXF) or GIS (Shapefile, GeoPackage).",
    ),
    "study": Listed(
        "photocal.commands.study:study",
        "Repeat a published study: copy its files, run its commands, compare with the printed results.",
    ),
}
app = application(
    "From flight log, images and control points to a calibrated camera and its certificate.", COMMANDS
)


def main() -> None:
    """Run the command line."""
    run_application(app)
