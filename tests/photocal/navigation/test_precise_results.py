"""Positions of services: the summary of CSRS-PPP, and SINEX."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.base.geodesy import geodetic
from photocal.navigation.precise_results import read_precise_result

# As the service prints it; values of a point in New Brunswick.
HEAD = "POS CRD  SYST        EPOCH          A_PRIORI         ESTIMATED       DIFF {} CORRELATIONS"
ROWS = (
    "POS   X NAD83 97:001:00000  1876338.3955  1876339.5340  1.1385  0.0066  0.0250  1.0000",
    "POS   Y NAD83 97:001:00000 -4012676.5744 -4012678.8820 -2.3076  0.0120  0.0209 -0.6666  1.0000",
    "POS   Z NAD83 97:001:00000  4573630.8987  4573629.9001 -0.9986  0.0134  0.0194  0.6667 -0.8357  1.0000",
    "POS LAT NAD83 97:001:00000  46  6 29.50207  46  6 29.41960 -2.5463  0.0051  0.0246  1.0000",
    "POS LON NAD83 97:001:00000 -64 56 20.69708 -64 56 20.69457  0.0539  0.0046  0.0178  0.0351  1.0000",
    "POS HGT NAD83 97:001:00000  52.0040  53.0679  1.0639  0.0179  0.0228  0.0195 -0.0609  1.0000",
)
PROPAGATED = "\n".join(["MKR base", HEAD.format("SIG_PPP(95%) SIG_TOT(95%)"), *ROWS]) + "\n"
SINEX = """\
%=SNX 2.02 AUS 26:262:00000 AUS 26:261:00000 26:261:86370 P 00003 2 X
+SOLUTION/ESTIMATE
*INDEX TYPE__ CODE PT SOLN _REF_EPOCH__ UNIT S __ESTIMATED VALUE____ _STD_DEV___
     1 STAX   MTRK  A    1 26:261:43200 m    2 -2.67481720000000e+04 4.00000e-03
     2 STAY   MTRK  A    1 26:261:43200 m    2  5.83715661840000e+06 6.00000e-03
     3 STAZ   MTRK  A    1 26:261:43200 m    2  2.56180126070000e+06 5.00000e-03
-SOLUTION/ESTIMATE
%ENDSNX
"""


def written(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text, encoding="ascii")
    return folder / name


def test_a_summary_gives_the_position_that_stands_beside_it(tmp_path: Path) -> None:
    """The same point stands there as X, Y, Z and as latitude, longitude, height; so do the sigmas."""
    result = read_precise_result(written(tmp_path, "base.sum", PROPAGATED))
    lat, lon, height = geodetic(result.position_m[None])
    assert lat[0] == pytest.approx(46 + 6 / 60 + 29.41960 / 3600, abs=1e-9)
    assert lon[0] == pytest.approx(-(64 + 56 / 60 + 20.69457 / 3600), abs=1e-9)
    assert height[0] == pytest.approx(53.0679, abs=2e-4)
    assert result.frame == "NAD83"
    assert result.epoch == pytest.approx(1997.0)
    # 95 % of the whole, east, north, up: as they stand in the rows of longitude, latitude and height.
    assert 1.96 * result.sigma_enu_m == pytest.approx([0.0178, 0.0246, 0.0228], rel=1e-3)


def test_without_a_transformation_one_sigma_stands_there(tmp_path: Path) -> None:
    """Its covariance, turned to X, Y, Z, has the sigmas and correlations that stand in their rows."""
    at = {"X": 8, "Y": 8, "Z": 8, "LAT": 12, "LON": 12, "HGT": 8}
    rows = [" ".join(cells[: (k := at[cells[1]])] + cells[k + 1 :]) for cells in map(str.split, ROWS)]
    text = "\n".join([HEAD.format("SIGMA(95%)"), *rows])
    result = read_precise_result(written(tmp_path, "base.sum", text))
    assert 1.96 * result.sigma_enu_m == pytest.approx([0.0046, 0.0051, 0.0179], rel=1e-3)
    sigma = np.sqrt(np.diag(result.covariance_m2))
    assert 1.96 * sigma == pytest.approx([0.0066, 0.0120, 0.0134], abs=2e-4)
    correlation = result.covariance_m2 / np.outer(sigma, sigma)
    assert correlation[np.tril_indices(3, -1)] == pytest.approx([-0.6666, 0.6667, -0.8357], abs=0.02)


def test_sinex_of_one_site(tmp_path: Path) -> None:
    result = read_precise_result(written(tmp_path, "base.snx", SINEX))
    assert result.position_m == pytest.approx([-26748.1720, 5837156.6184, 2561801.2607])
    assert np.sqrt(np.diag(result.covariance_m2)) == pytest.approx([0.004, 0.006, 0.005])
    assert result.epoch == pytest.approx(2026 + 260.5 / 365)
    two = SINEX.replace("-SOLUTION", SINEX.splitlines()[3].replace("MTRK", "BAKO") + "\n-SOLUTION")
    with pytest.raises(ConfigurationError, match="BAKO, MTRK"):
        read_precise_result(written(tmp_path, "two.snx", two))


def test_a_site_is_taken_from_a_file_of_several(tmp_path: Path) -> None:
    rows = SINEX.splitlines(keepends=True)
    other = [row.replace("MTRK", "UFPR").replace("-2.6748", " 3.7630") for row in rows[3:6]]
    path = written(tmp_path, "network.snx", "".join([*rows[:6], *other, *rows[6:]]))
    alone = written(tmp_path, "one.snx", SINEX)
    assert read_precise_result(path, "mtrk").position_m[0] == pytest.approx(-26748.1720)
    assert read_precise_result(path, "UFPR").position_m[0] == pytest.approx(37630.1720)
    assert read_precise_result(path, name="UFPR").position_m[0] == pytest.approx(37630.1720)
    # A file of a single site need not know how the mark is called; a site that is named must be there.
    assert read_precise_result(alone, name="BASE").position_m[0] == pytest.approx(-26748.1720)
    for wrong in (path, alone):
        with pytest.raises(ConfigurationError, match="has no site BRAZ") as refusal:
            read_precise_result(wrong, "BRAZ")
        assert "MTRK" in refusal.value.remedy
    with pytest.raises(ConfigurationError, match="has 2 sites"):
        read_precise_result(path)
    with pytest.raises(ConfigurationError, match="has no sites"):
        read_precise_result(written(tmp_path, "base.sum", PROPAGATED), "MTRK")


@pytest.mark.parametrize("text", ["hello\n", PROPAGATED.replace("-4012678.8820", "x"), "%=SNX 2.02\n"])
def test_what_is_no_result_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputMalformedError):
        read_precise_result(written(tmp_path, "base.sum", text))
