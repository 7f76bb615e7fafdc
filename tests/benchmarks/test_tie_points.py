"""Recorded drone flights: tie points beside COLMAP's, in one run on one machine.

Both find features, match, and orient the images; compared are verified tracks, all that are found and those
of three and more rays that are adjusted, reprojection, processor time and time by the clock. COLMAP has one
focal length and one radial coefficient, both estimated; so has our second adjustment. The third has what a
calibration estimates. Another folder of pictures: python -m tests.benchmarks.test_tie_points FOLDER
"""

from __future__ import annotations

import sys
import time
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.adjustment.adjust import adjust
from photocal.block.network import assemble
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.localisation import similarity
from photocal.measurement.image_file import list_images
from photocal.measurement.match_images import MatchingPlan
from photocal.measurement.picture_block import measure_images

pytestmark = [pytest.mark.shared, pytest.mark.timeout(7200)]
# Pictures of 9 and of 12 megapixels.
FLIGHTS = ("uav-brighton-beach/images", "flight-caliterra-twelve", "flight-lewis-ten")
# Of our camera. What the others have is the value of the EXIF, or zero.
ESTIMATED = {
    "c held": ("K1", "K2"),
    "c free": ("c", "K1"),
    "calibrated": ("c", "x0", "y0", "K1", "K2", "P1", "P2"),
}
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Figures:
    """What is compared."""

    images: int
    found: int
    tracks: int
    share_of_four: float
    rms_px: float
    sigma_px: float
    c_px: float
    exif_m: Floats
    processor_s: float
    clock_s: float

    def row(self, name: str) -> str:
        """Give a line of the table."""
        x, y, z = self.exif_m
        return (
            f"{name:10} {self.images:6d} {self.found:6d} {self.tracks:8d} {self.share_of_four:7.3f} "
            f"{self.rms_px:7.3f} {self.sigma_px:7.3f} {self.c_px:8.1f} {x:6.2f}/{y:.2f}/{z:.2f} "
            f"{self.processor_s:9.1f} {self.clock_s:8.1f}"
        )


HEAD = "           images  found tracks>2 4 rays rms_px sigma_px     c_px    EXIF_m    processor_s clock_s"


@pytest.mark.parametrize("flight", FLIGHTS)
def test_tie_points_beside_colmap(
    flight: str, shared: Path, tmp_path: Path, benchmark: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pycolmap", reason="the comparison needs pycolmap (pip install pycolmap)")
    folder = shared / "data" / flight
    with capsys.disabled():
        own = benchmark.pedantic(beside_colmap, args=(folder, tmp_path), rounds=1)
        ours, peer = own["calibrated"], own["COLMAP"]
        print(f"processor time {ours.processor_s / peer.processor_s:.2f} of COLMAP's")
    assert ours.images == peer.images == len(list_images(folder))
    # Ours are thinned before they are adjusted. What is left depends on the lens of each, too: it is printed.
    assert ours.found >= peer.found
    benchmark.extra_info["processor_time_over_colmap"] = ours.processor_s / peer.processor_s


def beside_colmap(folder: Path, work: Path) -> dict[str, Figures]:
    """Measure the pictures of a folder by both, and print the figures."""
    figures, observed = _own(folder, work / "cache")
    figures["COLMAP"] = _peer(folder, work / "colmap", observed)
    print("", folder, HEAD, *(one.row(name) for name, one in figures.items()), sep="\n", flush=True)
    return figures


def _now() -> tuple[float, float]:
    """Time of the processors and of the clock, s."""
    resource = pytest.importorskip("resource", reason="only POSIX systems tell the memory of a process")
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used), time.perf_counter()


def _since(began: tuple[float, float]) -> tuple[float, float]:
    processor_s, clock_s = _now()
    return processor_s - began[0], clock_s - began[1]


def _own(folder: Path, cache: Path) -> tuple[dict[str, Figures], dict[str, Floats]]:
    """Figures with the parameters that `ESTIMATED` names, and the positions of the EXIF."""
    began = _now()
    plan = MatchingPlan(cache, 2)
    made = measure_images(list_images(folder), "flight", plan, lambda *_: nullcontext(lambda _: None))
    spent = _since(began)
    block, figures = made.block, dict[str, Figures]()
    observed = block.images.values[:, 3:]
    for title, names in ESTIMATED.items():
        chosen = np.array([name in names for name in PARAMETERS])
        cameras = tuple(replace(one, estimated=chosen) for one in block.cameras)
        assembly = assemble(replace(block, cameras=cameras))
        solution = adjust(assembly.network)
        level = np.sqrt(np.mean(block.observations.sigma**2))
        figures[title] = Figures(
            len(block.images.names),
            made.record["tracks"]["of_features"],
            made.record["tracks"]["three_and_more_rays"],
            made.record["share_of_four_and_more"],
            float(np.sqrt(np.mean(solution.residuals**2))),
            float(level * np.sqrt(solution.variance_factor)),
            float(solution.cameras[0, 0]),
            _against(assembly.frame.to_given(solution.exposures[:, 3:]), observed),
            *spent,
        )
    return figures, dict(zip(block.images.names, observed, strict=True))


def _peer(folder: Path, work: Path, observed: dict[str, Floats]) -> Figures:
    import pycolmap

    work.mkdir()
    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(1)
    began = _now()
    options = pycolmap.ImageReaderOptions()
    options.camera_model = "SIMPLE_RADIAL"
    pycolmap.extract_features(
        work / "database.db",
        folder,
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=options,
        device=pycolmap.Device.cpu,
    )
    pycolmap.match_exhaustive(work / "database.db", device=pycolmap.Device.cpu)
    models = pycolmap.incremental_mapping(work / "database.db", folder, work / "sparse")
    spent = _since(began)
    model = max(models.values(), key=lambda one: len(one.images))
    lengths = np.array([point.track.length() for point in model.points3D.values()])
    misses = np.array(
        [
            model.images[seen.image_id].project_point(point.xyz)
            - model.images[seen.image_id].points2D[seen.point2D_idx].xy
            for point in model.points3D.values()
            for seen in point.track.elements
        ]
    )
    # Six unknowns an image less the seven of the datum, three a point, two of the camera.
    redundancy = misses.size - 3 * len(lengths) - 6 * len(model.images) + 7 - 2
    images = [image for image in model.images.values() if image.has_pose]
    centres = np.array([image.projection_center() for image in images])
    return Figures(
        len(images),
        len(lengths),
        int(np.count_nonzero(lengths >= 3)),
        float(np.mean(lengths >= 4)),
        float(np.sqrt(np.mean(misses**2))),
        float(np.sqrt(np.sum(misses**2) / redundancy)),
        float(next(iter(model.cameras.values())).params[0]),
        _against(centres, np.array([observed[image.name] for image in images])),
        *spent,
    )


def _against(centres: Floats, observed: Floats) -> Floats:
    """Root mean square of the differences after a similarity, m, shape (3,)."""
    fit = similarity(centres, observed)
    assert fit is not None
    return np.asarray(np.sqrt(np.mean((fit.applied(centres) - observed) ** 2, axis=0)))


if __name__ == "__main__":
    with TemporaryDirectory() as work:
        beside_colmap(Path(sys.argv[1]), Path(work))
