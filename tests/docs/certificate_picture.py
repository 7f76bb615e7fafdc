"""First page of a certificate in the README: a Kodak DCS460 calibrated from its published observations."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from PIL import Image

from photocal.analysis.analyse_run import analyse_run
from photocal.block.results.adjusted import adjust_block
from photocal.report.options import CertificateOptions
from photocal.run.certify import certificate
from tests.docs.rooms import ROOT

CERTIFICATE = ROOT / "docs" / "certificate.png"
_BLOCK = ROOT / "photocal" / "demo" / "dcs460"
# A page of A4 is 703 px wide.
_PPI = 85
_COLOURS = 64


def main() -> None:
    """Write it as the PDF has it, after the analysis that every run makes."""
    with tempfile.TemporaryDirectory() as folder:
        run, written = Path(folder) / "run", Path(folder) / "certificate"
        adjust_block(_BLOCK, run)
        analyse_run(run, _BLOCK)
        certificate(run, written, options=CertificateOptions(block=_BLOCK))
        draw_page(written / "certificate.pdf", CERTIFICATE)


def draw_page(written: Path, picture: Path) -> None:
    """Draw the first page of a document, where poppler is there to draw with."""
    draw = shutil.which("pdftoppm")
    if draw is None:
        print(f"no pdftoppm: {picture.name} stays as it is")
        return
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page"
        command = [draw, "-png", "-singlefile", "-r", str(_PPI), str(written), str(page)]
        subprocess.run(command, check=True)
        with Image.open(page.with_suffix(".png")) as drawn:
            drawn.convert("RGB").quantize(_COLOURS).save(picture, optimize=True)


if __name__ == "__main__":
    main()
