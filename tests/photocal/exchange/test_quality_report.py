"""Quality reports of other programs, as text, page or document."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import typst

from photocal.base.errors import InputMalformedError
from photocal.exchange.quality_report import QualityReport, read_quality_report, report_of, reports_near

# The text of a report of ODM 3.5.3 (18 pictures), of its issue tracker.
ODM = """ODM Quality Report
Processed with ODM version 3.5.3
Reconstructed Images 18 over 18 shots (100.0%)
Average Ground Sampling Distance (GSD) 1.6 cm
GPS errors 0.65 meters
GPS/GCP/3D Errors Details
GPS Mean Standard Deviation RMS Error
X Error (meters) -0.007 0.153 0.154
Y Error (meters) 0.007 0.610 0.610
Z Error (meters) 0.020 0.271 0.272
Total 0.646
3D Mean Standard Deviation RMS Error
X Error (meters) 0.010 0.010 0.014
Y Error (meters) 0.010 0.011 0.015
Z Error (meters) 0.015 0.020 0.025
Average Reprojection Error (normalized / pixels / angular) 0.06 / 0.77 / 0.00029
"""
PIX4D = """Quality Report
Generated with Pix4Dmapper version 4.5.6
Dataset 581 out of 583 images calibrated (99%), all images enabled
Mean Reprojection Error [pixels] 0.152
Initial Values 3666.667 [pixel] 8.600 [mm] 2736.001 [pixel] 6.417 [mm] 1824.001 [pixel] 4.278 [mm]
Uncertainties (Sigma) 0.462 [pixel] 0.001 [mm] 0.103 [pixel] 0.000 [mm] 0.087 [pixel] 0.000 [mm] 0.000 0.000
GCP Name Accuracy XY/Z [m] Error X [m] Error Y [m] Error Z [m] Projection Error [pixel] Verified/Marked
P1 (3D) 0.020/ 0.020 0.005 -0.011 0.003 0.556 9 / 9
Mean [m] 0.000123 -0.000456 0.000789
Sigma [m] 0.004 0.005 0.006
RMS Error [m] 0.00799 0.0112 0.0140
0 out of 2 check points have been labeled as inaccurate.
Check Point Name Accuracy XY/Z [m] Error X [m] Error Y [m] Error Z [m] Projection Error Verified/Marked
C 7 0.0200/0.0200 0.0123 0.0234 -0.0345 0.4560 12 / 12
Check-8 0.0200/0.0200 0.0123 0.0234 -0.0345 0.4560 12 / 12
Mean [m] 0.0123 0.0234 -0.0345
Sigma [m] 0.0 0.0 0.0
RMS Error [m] 0.0223 0.0234 0.0345
"""
METASHAPE = """Agisoft Metashape Processing Report
Number of images: 581 Camera stations: 579
Flying altitude: 92.3 m Tie points: 412,345
Ground resolution: 2.1 cm/pix Projections: 1,523,456
Coverage area: 0.31 km2 Reprojection error: 0.734 pix
X error (cm) Y error (cm) Z error (cm) XY error (cm) Total error (cm)
1.5 2.5 3.5 2.9 4.6
Table 3. Average camera location error.
Count X error (cm) Y error (cm) Z error (cm) XY error (cm) Total (cm)
6 0.51 0.62 0.73 0.80 1.09
Table 4. Control points RMSE.
Count X error (cm) Y error (cm) Z error (cm) XY error (cm) Total (cm)
2 1.1 1.2 1.3 1.6 2.1
Table 5. Check points RMSE.
Label X error (cm) Y error (cm) Z error (cm) Total (cm) Image (pix)
G1 0.2 0.3 0.4 0.5 0.321 (12)
Total 0.51 0.62 0.73 1.09 0.4
Table 6. Control points.
Label X error (cm) Y error (cm) Z error (cm) Total (cm) Image (pix)
K1 1.0 1.1 1.2 1.9 0.4 (9)
K2 -1.0 1.1 1.2 1.9 0.4 (8)
Table 7. Check points.
"""


def as_pdf(folder: Path, text: str) -> Path:
    """Set a text as a document, a line each."""
    source = folder / "report.typ"
    source.write_text("#set page(width: 40cm)\n```\n" + text + "```\n", encoding="utf-8")
    typst.compile(source, output=folder / "field_report.pdf")
    return folder / "field_report.pdf"


def as_page(folder: Path, text: str) -> Path:
    path = folder / "field_report.html"
    rows = "".join(f"<tr><td>{line}</td></tr>" for line in text.split("\n"))
    path.write_text(
        f"<html><style>td {{ }}</style><body><table>{rows}</table></body></html>", encoding="utf-8"
    )
    return path


def as_text(folder: Path, text: str) -> Path:
    path = folder / "field_report.txt"
    path.write_text(text, encoding="utf-8")
    return path


def read(path: Path) -> QualityReport:
    report = read_quality_report(path)
    assert report is not None
    return report


@pytest.mark.parametrize("written", [as_text, as_page, as_pdf])
def test_a_report_of_pix4d(tmp_path: Path, written: object) -> None:
    report = read(written(tmp_path, PIX4D))  # type: ignore[operator]
    assert (report.program, report.calibrated, report.images) == ("Pix4D", 581, 583)
    assert report.reprojection_px == 0.152
    assert report.control_m == (0.00799, 0.0112, 0.0140)
    assert report.check_m == (0.0223, 0.0234, 0.0345)
    assert report.checks == ("C 7", "Check-8")
    assert report.camera_sigma_px == ({"c": 0.462, "x0": 0.103, "y0": 0.087},)


def test_a_report_of_pix4d_as_xml(tmp_path: Path) -> None:
    path = tmp_path / "field_report.xml"
    path.write_text(
        '<report project="field"><results><initial><images total="583" calibrated="581"/>'
        '<atps meanProjectionError="0.152"/><camera name="P1"><uncertainties>'
        "<focalLengthPixel>0.46</focalLengthPixel><principalPointXPixel>0.1</principalPointXPixel>"
        '</uncertainties></camera><statsControlPoints><gcps><rms x="0.01" y="0.02" z="0.03"/></gcps>'
        '<checkPoints><inliers><gcp name="C7"><error x="1"/></gcp></inliers>'
        '<rms x="0.04" y="0.05" z="0.06"/></checkPoints></statsControlPoints></initial></results></report>'
    )
    report = read(path)
    assert (report.calibrated, report.images, report.reprojection_px) == (581, 583, 0.152)
    assert (report.control_m, report.check_m) == ((0.01, 0.02, 0.03), (0.04, 0.05, 0.06))
    assert report.checks == ("C7",)
    assert report.camera_sigma_px == ({"c": 0.46, "x0": 0.1},)


@pytest.mark.parametrize("written", [as_text, as_pdf])
def test_a_report_of_odm(tmp_path: Path, written: object) -> None:
    report = read(written(tmp_path, ODM))  # type: ignore[operator]
    assert (report.program, report.calibrated, report.images) == ("ODM", 18, 18)
    assert report.reprojection_px == 0.77
    assert report.position_m == (0.154, 0.610, 0.272)
    assert all(math.isnan(value) for value in report.control_m)


def test_statistics_of_odm(tmp_path: Path) -> None:
    path = tmp_path / "stats.json"
    statistics = {
        "initial_shots_count": 20,
        "reconstructed_shots_count": 18,
        "reprojection_error_pixels": 0.77,
    }
    errors = {"error": {"x": 0.1, "y": 0.2, "z": 0.3}}
    path.write_text(json.dumps({"reconstruction_statistics": statistics, "gcp_errors": errors}))
    report = read(path)
    assert (report.images, report.calibrated, report.reprojection_px) == (20, 18, 0.77)
    assert report.control_m == (0.1, 0.2, 0.3)


@pytest.mark.parametrize("written", [as_text, as_pdf])
def test_a_report_of_metashape(tmp_path: Path, written: object) -> None:
    report = read(written(tmp_path, METASHAPE))  # type: ignore[operator]
    assert (report.program, report.images, report.calibrated) == ("Metashape", 581, 579)
    assert (report.reprojection_px, report.kind) == (0.734, "rms")
    assert report.position_m == pytest.approx((0.015, 0.025, 0.035))
    assert report.control_m == pytest.approx((0.0051, 0.0062, 0.0073))
    assert report.check_m == pytest.approx((0.011, 0.012, 0.013))
    assert report.checks == ("K1", "K2")


def test_reports_lie_where_programs_put_them(tmp_path: Path) -> None:
    params = tmp_path / "1_initial" / "params"
    (tmp_path / "1_initial" / "report" / "html").mkdir(parents=True)
    params.mkdir()
    as_page(tmp_path / "1_initial" / "report" / "html", PIX4D)
    for folder in (params, tmp_path):
        report, refusals = report_of(folder, lambda program: program == "Pix4D")
        assert report is not None
        assert not refusals
    assert report_of(params, lambda program: program == "ODM") == (None, [])
    # What lies beside a project is of another.
    (tmp_path / "another project").mkdir()
    assert report_of(tmp_path / "another project", lambda _: True) == (None, [])


@pytest.mark.parametrize("content", [b"", b"%PDF-1.7\n1 0 obj <<", b"%PDF-1.4 " + b"\xff" * 500, b"\0" * 99])
def test_a_damaged_document_is_refused_in_a_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "field_report.pdf"
    path.write_bytes(content)
    with pytest.raises(InputMalformedError, match="is not a readable PDF"):
        read_quality_report(path)
    report, refusals = report_of(tmp_path, lambda _: True)
    assert report is None
    assert len(refusals) == 1


def test_other_documents_are_no_reports(tmp_path: Path) -> None:
    as_text(tmp_path, "A report on something else.\n")
    (tmp_path / "report.json").write_text("[1, 2]")
    (tmp_path / "report.xml").write_text("<other/>")
    assert len(reports_near(tmp_path)) == 3
    assert report_of(tmp_path, lambda _: True) == (None, [])


# As users of Tapas and GCPBascule publish what they print (six air photos of Mount St Helens).
MICMAC = """    RES:[OIS-AR5840034159998.tif][C] ER2 0.8 Nn 99.1 Of 10897 Mul 4329 Mul-NN 4320 Time 0.333
    | |  Residual = 0.9 ;; Evol, Moy=4.3e-03 ,Max=5.3e-03
    --- End Iter 2 STEP 3
    RES:[OIS-AR5840034159998.tif][C] ER2 0.677032 Nn 99.7247 Of 10897 Mul 4329 Mul-NN 4320 Time 0.333
    RES:[OIS-AR5840034159999.tif][C] ER2 0.697072 Nn 99.7558 Of 4914 Mul 929 Mul-NN 927 Time 0.14
    ----- Stat on type of point (ok/elim) ----
         *   Perc=99.709% ;  Nb=49342 for Ok
    | |  Residual = 0.671665 ;; Evol, Moy=4.31328e-08 ,Max=5.30388e-08
    | |  Worst, Res 0.697072 for OIS-AR5840034159999.tif,  Perc 99.6733 for OIS-AR5840034159995.tif
    ==== ADD Pts GCP5 Has Gr 1 Inc [1, 1, 1]
    NOT OK (UPL) FOR GCP5 , Reason NoPb
    ==== ADD Pts GCP6 Has Gr 1 Inc [1, 1, 1]
    --NamePt GCP6 Ec Estim-Ter [-3.0,4.0,-1.0]           Dist =5.09902 ground units
    --NamePt GCP7 Ec Estim-Ter [4.0,3.0,7.0]           Dist =8.60233 ground units
"""
# Lines of RunModelAnalyzer; later versions put their log's head before each.
COLMAP = (
    "Cameras: 1", "Images: 12", "Registered images: 10", "Points: 2696", "Observations: 9876",
    "Mean track length: 3.663", "Mean observations per image: 987.600000",
    "Mean reprojection error: 0.713000px",
)  # fmt: skip


def test_what_micmac_prints(tmp_path: Path) -> None:
    path = tmp_path / "campari.log"
    path.write_text(MICMAC, encoding="utf-8")
    report = read(path)
    assert (report.program, report.kind, report.reprojection_px) == ("MicMac", "rms", 0.671665)
    assert report.calibrated == 2
    # The square roots of (9 + 16) / 2, (16 + 9) / 2 and (1 + 49) / 2.
    assert report.control_m == pytest.approx((3.535534, 3.535534, 5.0), abs=1e-6)
    assert reports_near(tmp_path) == [path]


@pytest.mark.parametrize("head", ["", "I20250412 20:08:49.215745 96464 model.cc:445] "])
def test_what_colmap_prints(tmp_path: Path, head: str) -> None:
    path = tmp_path / "model_analyzer.txt"
    path.write_text("".join(f"{head}{line}\n" for line in COLMAP), encoding="utf-8")
    report = read(path)
    assert (report.program, report.images, report.calibrated) == ("COLMAP", 12, 10)
    assert report.reprojection_px == 0.713
    assert reports_near(tmp_path) == [path]
