"""Computed edges, stars and even surfaces, against the blur, fall of light and line that made them."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.optimize import brentq
from scipy.special import erf
from typer.testing import CliRunner

from photocal.base.arrays import Floats
from photocal.base.errors import InputMalformedError
from photocal.commands.cli import app
from photocal.measurement.radiometry import edge_mtf, falls_to, linearity, siemens_star, vignetting
from photocal.report.certificate_metadata import read_particulars

# Samples of a pixel in a row and in a column: its area.
FINE = 5


def edge(sigma: float, slant_deg: float, size: tuple[int, int] = (120, 80)) -> Floats:
    """A picture of an edge blurred by a Gaussian and taken by square pixels."""
    step = (np.arange(FINE) - (FINE - 1) / 2) / FINE
    y, x = (np.add.outer(np.arange(n), step).ravel() for n in size)
    turn = np.radians(slant_deg)
    apart = (x[None] - size[1] / 2) * np.cos(turn) - (y[:, None] - size[0] / 2) * np.sin(turn)
    fine = 40 + 160 * 0.5 * (1 + erf(apart / (sigma * np.sqrt(2))))
    return np.asarray(fine.reshape(size[0], FINE, size[1], FINE).mean(axis=(1, 3)))


def true_mtf(frequency: Floats | float, sigma: float) -> Floats:
    """Gaussian, and the sampled width of a pixel."""
    f = np.asarray(frequency, dtype=float)
    with np.errstate(invalid="ignore"):
        box = np.where(f == 0, 1.0, np.sin(np.pi * f) / (FINE * np.sin(np.pi * f / FINE)))
    return np.asarray(np.exp(-2 * (np.pi * sigma * f) ** 2) * np.abs(box))


@pytest.mark.parametrize("sigma", [0.5, 0.8, 1.2])
@pytest.mark.parametrize("slant", [3.0, 5.0, -8.0])
@pytest.mark.parametrize("turned", [False, True])
def test_transfer_of_a_slanted_edge(sigma: float, slant: float, turned: bool) -> None:
    picture = edge(sigma, slant)
    frequency, found, seen = edge_mtf(picture.T if turned else picture)
    assert seen == pytest.approx(abs(slant), abs=0.05)
    half = frequency <= 0.5
    assert found[half] == pytest.approx(true_mtf(frequency[half], sigma), abs=0.02)
    true = brentq(lambda f: float(true_mtf(f, sigma)) - 0.5, 0.01, 0.9)
    assert falls_to(frequency, found, 0.5) == pytest.approx(true, rel=0.02)


def test_noise_moves_the_transfer_little() -> None:
    rng = np.random.default_rng(3)
    half = [falls_to(*edge_mtf(edge(0.8, 5.0) + rng.normal(0, 2, (120, 80)))[:2], 0.5) for _ in range(30)]
    true = brentq(lambda f: float(true_mtf(f, 0.8)) - 0.5, 0.01, 0.9)
    assert np.mean(half) == pytest.approx(true, rel=0.02)
    assert np.std(half) < 0.02


@pytest.mark.parametrize("picture", [edge(0.8, 0.0), np.full((60, 60), 9.0), edge(0.8, 5.0)[:, :38]])
def test_what_is_no_slanted_edge(picture: Floats) -> None:
    with pytest.raises(InputMalformedError, match="slanted"):
        edge_mtf(picture)


def star(sigma: float, spokes: int = 36) -> Floats:
    """A star of sectors about (201.3, 198.6), blurred and taken by square pixels."""
    from scipy.ndimage import gaussian_filter

    step = (np.arange(FINE) - (FINE - 1) / 2) / FINE
    y, x = (np.add.outer(np.arange(400), step).ravel() for _ in range(2))
    sectors = np.sin(spokes * np.arctan2(y[:, None] - 198.6, x[None] - 201.3)) > 0
    fine = gaussian_filter(50.0 + 100.0 * sectors, sigma * FINE)
    return np.asarray(fine.reshape(400, FINE, 400, FINE).mean(axis=(1, 3)))


@pytest.mark.parametrize("sigma", [0.7, 1.1])
def test_contrast_in_a_siemens_star(sigma: float) -> None:
    """The middle is found; contrast is that of the blur and the pixel, relative to the rim's."""
    frequency, found = siemens_star(star(sigma), (203.0, 200.0), 180.0, 36)
    rim = true_mtf(frequency[:6], sigma).mean()
    assert found == pytest.approx(true_mtf(frequency, sigma) / rim, abs=0.03)
    true = brentq(lambda f: float(true_mtf(f, sigma)) / rim - 0.1, 0.05, 0.95)
    assert falls_to(frequency, found, 0.1) == pytest.approx(true, rel=0.05)
    with pytest.raises(InputMalformedError, match="no star of 35 spokes"):
        siemens_star(star(sigma), (203.0, 200.0), 180.0, 35)
    with pytest.raises(InputMalformedError, match="no complete star"):
        siemens_star(star(sigma), (20.0, 200.0), 180.0, 36)


def test_fall_of_light_and_linearity() -> None:
    """cos^4 to a corner at 30 degrees is 9/16; a line with one value 2 % of the range off."""
    y, x = np.indices((301, 401))
    tangent = np.hypot(x - 200, y - 150) / 250 * np.tan(np.radians(30))
    share, _ = vignetting(180 / (1 + tangent**2) ** 2)
    assert share == pytest.approx(9 / 16, abs=1e-3)
    exposure = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    assert linearity(exposure, 7 + 20 * exposure) == pytest.approx((0.0, 1.0), abs=1e-12)
    bent = 7 + 20 * exposure + np.array([0, 0, 2.0, 0, 0])
    assert linearity(exposure, bent)[0] == pytest.approx(0.8 * 2.0 / 80)
    with pytest.raises(InputMalformedError, match="three"):
        linearity(exposure[:2], bent[:2])


def test_the_command_writes_what_a_certificate_reads(tmp_path: Path) -> None:
    rng, flats = np.random.default_rng(1), tmp_path / "flats"
    flats.mkdir()
    Image.fromarray(np.round(edge(0.8, 5.0)).astype(np.uint8)).save(tmp_path / "edge.png")
    Image.fromarray(np.round(star(0.7)).astype(np.uint8)).save(tmp_path / "star.png")
    for k, time in enumerate((0.001, 0.002, 0.004)):
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0x829A] = time
        grey = np.clip(50_000 * time + rng.normal(0, 1, (90, 120)), 0, 255)
        Image.fromarray(np.round(grey).astype(np.uint8)).save(flats / f"{k}.jpg", exif=exif, quality=100)
    output = tmp_path / "radiometry.toml"
    command = [
        "radiometry",
        "--edge",
        str(tmp_path / "edge.png"),
        "--star",
        str(tmp_path / "star.png"),
        "--place",
    ]
    command += ["203,200,180", "--gsd-cm", "2", "--flat", str(flats), "-o", str(output), "--json"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    assert figures["corner_brightness"] == pytest.approx(1.0, abs=0.01)
    assert figures["linearity_error"] < 0.005
    assert figures["ground_resolution_cm"] == pytest.approx(2 / figures["star_limit_cycles_px"], rel=1e-3)
    given = read_particulars(output, dt.date(2026, 1, 2))
    assert given.radiometry["mtf50_cycles_px"] == figures["mtf50_cycles_px"]
    said = CliRunner().invoke(app, [*command[:-3], "--lang", "pt-BR"])
    assert f"MTF 50 %: {figures['mtf50_cycles_px']} ciclos/px".replace(".", ",") in said.stdout


@pytest.mark.parametrize(
    ("given", "refusal"),
    [
        ("", "nothing to measure"),
        ("--edge {0} --region 60,0,40,40", "not within the picture of 80 x 120 px"),
        ("--edge {0} --region=-5,0,40,40", "not within the picture"),
        ("--flat {1} --region 0,0,40,40", "--region without --edge"),
        ("--edge {0} --gsd-cm 2", "without --star"),
        ("--star {0} --place 40,60,30 --gsd-cm 0", "not positive"),
        ("--star {0} --place 40,60,30", "edge.png: has no star of 36 spokes"),
    ],
)
def test_what_cannot_be_measured_is_refused(tmp_path: Path, given: str, refusal: str) -> None:
    Image.fromarray(np.round(edge(0.8, 5.0)).astype(np.uint8)).save(tmp_path / "edge.png")
    command = ["radiometry", *given.format(tmp_path / "edge.png", tmp_path).split()]
    assert refusal in str(CliRunner().invoke(app, command).exception)
