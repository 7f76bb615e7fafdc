"""All 18 images of the recorded drone flight: tie points, block, and the figures against COLMAP's.

Run: python tests/benchmarks/tie_points_brighton_beach.py SHARED_FOLDER CACHE_FOLDER [PROCESSES]
"""

from __future__ import annotations

import sys
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.block.network import assemble
from photocal.geometry.similarity import similarity
from photocal.measurement.image_file import list_images
from photocal.measurement.match_images import MatchingPlan
from photocal.measurement.measure_ties import measure_ties

# COLMAP with SIMPLE_RADIAL on the same images: share of points with four rays, a posteriori sigma and rms of
# a coordinate (px), positions against EXIF after similarity (m), tracks of three and more rays.
PEER = {"share": 0.558, "sigma": 0.89, "rms": 0.71, "exif": (0.20, 0.36, 0.20), "tracks": 7040}


def main(shared: Path, cache: Path, processes: int) -> None:
    """Measure, adjust and print asked and seen."""
    paths = list_images(shared / "data/uav-brighton-beach/images")
    began = time.perf_counter()
    made = measure_ties(
        paths, "brighton-beach", MatchingPlan(cache, processes), lambda *_: nullcontext(lambda _: None)
    )
    seconds = time.perf_counter() - began
    assembly = assemble(made.block)
    solution = adjust(assembly.network)
    centres = assembly.frame.to_given(solution.exposures[:, 3:])
    observed = made.block.images.values[:, 3:]
    fit = similarity(centres, observed)
    exif = (
        np.full(3, np.nan)
        if fit is None
        else np.sqrt(np.mean((fit.applied(centres) - observed) ** 2, axis=0))
    )
    record = made.record
    sigma = record["sigma_px"] * np.sqrt(solution.variance_factor)
    print(f"images in the block    {len(record['images'])} of 18")
    print(f"points with 4 rays     {record['share_of_four_and_more']:.3f} (peer {PEER['share']})")
    print(f"tracks of 3 and more   {record['tracks']['three_and_more_rays']} (peer {PEER['tracks']})")
    print(f"sigma a posteriori px  {sigma:.3f} (peer {PEER['sigma']})")
    print(f"rms px                 {np.sqrt(np.mean(solution.residuals**2)):.3f} (peer {PEER['rms']})")
    print(f"EXIF x, y, z m         {exif.round(3)} (peer {PEER['exif']})")
    print(f"wall time s            {seconds:.1f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 2)
