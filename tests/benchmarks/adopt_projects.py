"""Projects of real size, made up and adopted: processor time, from the program's start to the certificate.

`python -m tests.benchmarks.adopt_projects one` is 581 images of one camera and some 104 000 rays, `five`
1 420 images of a rig whose oblique heads look 40 degrees out, by a common clock, and some 457 000 rays.
A second word names another layout than Pix4D's: colmap-text, colmap-binary, opensfm or metashape, whose
camera XML has markers only: there as many as its rays.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.photocal.exchange.pix4d_folder import write_params
from tests.photocal.exchange.rig_projects import LAYOUTS, ORIGIN, project

# Exposures, heads and rays that are wanted of an image.
PROJECTS = {"one": (581, 1, 190), "five": (284, 5, 250)}


def main(name: str, layout: str) -> None:
    """Make a project, adopt it and say what that took."""
    made, positions = project(*PROJECTS[name], ORIGIN if layout == "pix4d" else np.zeros(3))
    with tempfile.TemporaryDirectory() as folder:
        given = Path(folder, "project")
        given.mkdir()
        if layout == "pix4d":
            write_params(given, made, positions=positions, offset=np.round(made.images.values[0, 3:]))
        else:
            LAYOUTS[layout](given, made)
        path = given / "cameras.xml" if layout == "metashape" else given
        command = [sys.executable, "-m", "photocal", "adopt", str(path), "-o", str(Path(folder, "out"))]
        subprocess.run(command, check=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"{layout}: {len(made.images.names)} images, {len(made.observations.image)} rays: "
        f"{used.ru_utime + used.ru_stime:.1f} s of processor time, {used.ru_maxrss / 1024:.0f} MB"
    )


if __name__ == "__main__":
    main(*[*sys.argv[1:], *("one", "pix4d")[len(sys.argv) - 1 :]][:2])
