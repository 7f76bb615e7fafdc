"""Antenna models: found in ANTEX, and applied by the engine as a computation by hand has it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.navigation.engine import ProcessingOptions, configuration
from photocal.navigation.ppk import with_antennas
from photocal.navigation.precise_results import antenna_named, read_antennas
from tests.photocal.navigation.conftest import Run, ppk

# North, east, up of the phase centre over the reference point, mm.
OFFSET_MM = (12.5, -7.25, 61.4)


def antex(folder: Path) -> Path:
    """A satellite, an antenna with an offset and variations, and one without either."""

    def line(text: str, label: str) -> str:
        return f"{text:<60}{label}"

    def antenna(name: str, offset: tuple[float, ...], variations: str) -> list[str]:
        rows = [
            line("", "START OF ANTENNA"),
            line(f"{name:<20}", "TYPE / SERIAL NO"),
            line("     0.0", "DAZI"),
            line("     0.0  90.0  45.0", "ZEN1 / ZEN2 / DZEN"),
            line("     2", "# OF FREQUENCIES"),
        ]
        for frequency in ("G01", "G02"):
            rows += [
                line(f"   {frequency}", "START OF FREQUENCY"),
                line("".join(f"{v:10.2f}" for v in offset), "NORTH / EAST / UP"),
                f"   NOAZI{variations}",
                line(f"   {frequency}", "END OF FREQUENCY"),
            ]
        return [*rows, line("", "END OF ANTENNA")]

    flat, bent = "    0.00    0.00    0.00", "    0.00   -3.00    5.00"
    lines = [line("     1.4            M", "ANTEX VERSION / SYST"), line("A", "PCV TYPE / REFANT")]
    lines.append(line("", "END OF HEADER"))
    lines += antenna("BLOCK IIF           G01                 ", (394.0, 0.0, 1501.8), flat)
    lines += antenna("HANDMADE        NONE", OFFSET_MM, flat)
    lines += antenna("HANDMADE        CONE", OFFSET_MM, bent)
    lines += antenna("PLAIN           NONE", (0.0, 0.0, 0.0), flat)
    path = folder / "models.atx"
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def test_names_are_found_as_receivers_write_them(tmp_path: Path) -> None:
    path = antex(tmp_path)
    models = read_antennas(path)
    assert models == ("HANDMADE NONE", "HANDMADE CONE", "PLAIN NONE")
    assert antenna_named(models, "HANDMADE  CONE", path) == "HANDMADE CONE"
    # A radome that was never calibrated: the antenna without one.
    assert antenna_named(models, "HANDMADE SNOW", path) == "HANDMADE NONE"
    with pytest.raises(ConfigurationError, match="PLAIN NONE"):
        antenna_named(models, "PLANE NONE", path)
    (tmp_path / "other.atx").write_text(path.read_text().replace("-3.00", "-3,00"), encoding="ascii")
    with pytest.raises(InputMalformedError, match="is damaged"):
        read_antennas(tmp_path / "other.atx")
    (tmp_path / "other.atx").write_text("PGM : nothing\n", encoding="ascii")
    with pytest.raises(InputMalformedError):
        read_antennas(tmp_path / "other.atx")


def test_the_engine_gets_models_and_the_heights_of_the_headers(tmp_path: Path) -> None:
    path = antex(tmp_path)
    told = SimpleNamespace(path=tmp_path / "base.obs", antenna="HANDMADE NONE", antenna_m=1.234)
    silent = SimpleNamespace(path=tmp_path / "rover.obs", antenna="", antenna_m=0.0)
    made = with_antennas(ProcessingOptions("G", True), path, (silent, "none"), (told, ""))  # type: ignore[arg-type]
    settings = dict(row.split("=", 1) for row in configuration("static", "forward", made).splitlines())
    assert (settings["ant1-anttype"], settings["ant2-anttype"]) == ("*", "HANDMADE NONE")
    assert settings["ant2-antdelu"] == "1.2340"
    assert settings["pos1-posopt2"] == "on"
    assert "file-satantfile" not in settings
    with pytest.raises(ConfigurationError, match="the antenna of the rover is not stated"):
        with_antennas(ProcessingOptions("G", True), path, (silent, ""), (told, ""))  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match="needs a file"):
        with_antennas(ProcessingOptions("G", True), None, (silent, "X"), (told, ""))  # type: ignore[arg-type]


def test_positions_move_by_the_offset_of_the_antenna(static_run: Run, tmp_path: Path) -> None:
    """RTKLIB's own correction against the offset by hand: the mark lies below the phase centre."""
    models = antex(tmp_path)
    options = ("--antex", str(models), "--rover-antenna", "HANDMADE NONE", "--base-antenna", "PLAIN NONE")
    with_models = ppk(static_run.log, tmp_path / "ppk", *options)
    both = static_run.fixed & with_models.fixed
    assert both.mean() > 0.5
    moved = {
        name: (with_models.column(name) - static_run.column(name))[both]
        for name in ("lat_deg", "lon_deg", "height_m")
    }
    assert -1e3 * np.median(moved["height_m"]) == pytest.approx(OFFSET_MM[2], abs=0.1)
    # A degree of latitude there is 111 200 m, of longitude less by its cosine; 9 decimals are 0.1 mm.
    latitude = np.median(static_run.column("lat_deg"))
    metres = 111_132.95 - 559.85 * np.cos(np.radians(2 * latitude))
    assert -1e3 * metres * np.median(moved["lat_deg"]) == pytest.approx(OFFSET_MM[0], abs=0.15)
    metres = 111_412.88 * np.cos(np.radians(latitude)) - 93.5 * np.cos(np.radians(3 * latitude))
    assert -1e3 * metres * np.median(moved["lon_deg"]) == pytest.approx(OFFSET_MM[1], abs=0.15)
