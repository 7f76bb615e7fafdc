"""Camera calibration on a sheet of targets: DBAT's six lens models, and its three failures."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.base.errors import IllPosedError, InputMalformedError
from photocal.block.network import assemble
from photocal.exchange.dbat import read_dbat
from photocal.exchange.dbat_camera import NAMES, OURS, to_dbat
from photocal.exchange.photomodeler import block_from_export, read_control, read_export
from photocal.geometry.camera import PARAMETERS

pytestmark = pytest.mark.shared


@pytest.fixture
def folder(shared: Path) -> Path:
    return shared / "data" / "dbat-camcal"


def set_up(folder: Path, lens_model: int, target: Path) -> Path:
    """The published set-up with another lens model."""
    for name in ("camcal-fixed.txt", "markpts.txt", "images.txt"):
        (target / name).write_bytes((folder / "script" / name).read_bytes())
    text = (folder / "script" / "camcaldemo.xml").read_text(encoding="utf-8")
    assert text.count("<model>3</model>") == 1
    path = target / "setup.xml"
    path.write_text(text.replace("<model>3</model>", f"<model>{lens_model}</model>"), encoding="utf-8")
    return path


@pytest.mark.parametrize("lens_model", [-1, 1, 2, 3, 4, 5])
def test_lens_models(folder: Path, lens_model: int, tmp_path: Path, dbat_report: Any, adjusted: Any) -> None:
    report = dbat_report(folder / "dbatreports" / f"camcal-dbatreport-model{lens_model}.txt")
    block = read_dbat(set_up(folder, lens_model, tmp_path))
    _, solution = adjusted(block)
    assert solution.degrees_of_freedom == report.redundancy
    assert solution.unknowns == report.unknowns
    sigma0 = math.sqrt(solution.variance_factor)
    assert abs(sigma0 - report.sigma0.value) <= 1e-4
    values = to_dbat(block.cameras[0].with_values(solution.cameras[0]), lens_model)
    index = [PARAMETERS.index(name) for name in OURS]
    jacobian = np.diag([1.0, 1, -1, 1, 1, -1, -1, -1, -1, -1, -1])
    if lens_model == 5:
        # px' = (1 + as) px
        jacobian[1, 1], jacobian[1, 3] = 1 + values["as"], values["px"] / (1 + values["as"])
    covariance = jacobian @ solution.camera_covariance[0][np.ix_(index, index)] @ jacobian.T
    sigma = dict(zip(NAMES, np.sqrt(np.diag(covariance)) * sigma0, strict=True))
    compared = 0
    for name in NAMES:
        printed, deviation = report.cameras.get(name, (None, None))
        if deviation is None:
            continue
        compared += 1
        rounding = 0.5 * printed.unit
        assert abs(values[name] - printed.value) <= 0.05 * deviation.value + rounding, name
        assert sigma[name] == pytest.approx(deviation.value, rel=0.01, abs=0.5 * deviation.unit), name
    assert compared == solution.unknowns - 126 - 288
    for (one, other), percent in report.correlations.items():
        i, j = NAMES.index(one), NAMES.index(other)
        found = covariance[i, j] / math.sqrt(covariance[i, i] * covariance[j, j])
        assert found == pytest.approx(percent.value / 100, abs=0.01)
    # What the report does not name is below its limit of 95 %.
    estimated = [name for name in NAMES if sigma[name] > 0]
    for one, other in itertools.combinations(estimated, 2):
        if (one, other) not in report.correlations:
            i, j = NAMES.index(one), NAMES.index(other)
            assert abs(covariance[i, j]) < 0.95 * math.sqrt(covariance[i, i] * covariance[j, j])


def test_orientations_of_the_script(folder: Path, dbat_report: Any, adjusted: Any) -> None:
    report = dbat_report(folder / "script" / "result" / "report.txt")
    block = read_dbat(folder / "script" / "camcaldemo.xml")
    found, solution = adjusted(block)
    sigma0 = math.sqrt(solution.variance_factor)
    short = report.tolerance * report.last_error / sigma0
    for k, name in enumerate(block.images.names):
        pose = found.images.values[k].copy()
        pose[:3] = np.degrees(pose[:3])
        sigma = found.images.sigma[k] * sigma0
        sigma[:3] = np.degrees(sigma[:3])
        for value, sd, key in zip(pose, sigma, ("Omega", "Phi", "Kappa", "Xc", "Yc", "Zc"), strict=True):
            printed, deviation = report.photos[name][key]
            # Kappa near 180 degrees may be printed a whole turn away.
            apart = math.remainder(value - printed.value, 360) if key == "Kappa" else value - printed.value
            assert abs(apart) <= 2 * printed.unit + short * sd, (name, key)
            assert abs(sd - deviation.value) <= 2 * deviation.unit, (name, key)


@pytest.mark.parametrize("control", ["fixed", "weighted"])
def test_fixed_and_weighted_control(folder: Path, control: str, dbat_report: Any, adjusted: Any) -> None:
    """PhotoModeler's exports of the same images, adjusted by DBAT with the exported camera held."""
    own = folder / "prague2016"
    # The weighted run used the same measurements, of which the folder has the export only.
    export = read_export(own / f"{control}-with-orient-pmexport.txt")
    block = block_from_export(export, read_control(own / f"ctrlpts-{control}.txt"))
    report = dbat_report(own / f"{control}-with-orient-dbatreport.txt")
    _, solution = adjusted(block)
    assert solution.degrees_of_freedom == report.redundancy
    assert math.sqrt(solution.variance_factor) == pytest.approx(report.sigma0.value, abs=1e-4)


def test_one_ray(folder: Path) -> None:
    export = read_export(folder / "pmexports" / "camcal-pmexport-1ray.txt")
    block = block_from_export(export, read_control(folder / "prague2016" / "ctrlpts-fixed.txt"))
    with pytest.raises(InputMalformedError, match="tie point 88 has one ray"):
        assemble(block)


def test_missing_observations(folder: Path) -> None:
    export = read_export(folder / "pmexports" / "camcal-pmexport-missing-obs.txt")
    control = read_control(folder / "prague2016" / "ctrlpts-fixed.txt")
    with pytest.raises(InputMalformedError, match="object point 13, 60 has no observation"):
        block_from_export(export, control)


def test_no_datum(folder: Path) -> None:
    export = read_export(folder / "pmexports" / "camcal-pmexport.txt")
    block = block_from_export(replace(export, control={}), {})
    with pytest.raises(IllPosedError, match="nothing fixes the datum"):
        assemble(block)
