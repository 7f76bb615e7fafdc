"""Every row of the ministry's form is filled or marked as not determined."""

from __future__ import annotations

import csv
import datetime as dt
import tomllib
from pathlib import Path
from typing import Any

import pytest

from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError
from photocal.findings.document import KeyValues, Paragraph, Signature, TablePart
from photocal.findings.texts import catalogue
from photocal.report.certificate import certificate
from photocal.report.certificate_metadata import Metadata, read_particulars
from photocal.report.derived_figures import derived_figures
from photocal.report.ministry_rows import Context, corners, entries, read_layout
from photocal.report.stored_analysis import AnalysedRun

DAY = dt.date(2026, 11, 21)
EXAMPLE = Path(__file__).parents[3] / "configs" / "certificates" / "example_particulars.toml"

# The example, made to fit the invented camera: 4000 x 3000 px, c = 3412.5 px.
FITTING = {
    "camera": {"sensor_size_mm": [9.64, 7.23], "nominal_focal_length_mm": 8.2},
    "campaign": {"gsd_cm": 2.93},
}


def fitting() -> Metadata:
    keys: dict[str, Any] = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    for section, changed in FITTING.items():
        keys[section] |= changed
    return Metadata.model_validate({**keys, "date": DAY})


def context(run: AnalysedRun, particulars: Metadata, language: str = "en") -> Context:
    camera = next(iter(run.result.cameras))
    return Context(run, particulars, derived_figures(run, camera, particulars), catalogue(language))


@pytest.mark.shared
def test_layout_has_the_rows_of_the_form_in_their_order(shared: Path) -> None:
    with (shared / "reference/phantom4pro/certificate_layout.csv").open(encoding="utf-8") as stream:
        form = [(row["section"], row["item"]) for row in csv.DictReader(stream)]
    assert [(row["section"], row["item"]) for row in read_layout()] == form
    assert len(form) == 47


def test_keys_are_unique() -> None:
    keys = [row["key"] for row in read_layout()]
    assert len(keys) == len(set(keys)) == 47


@pytest.mark.parametrize("language", ["en", "pt-BR"])
def test_all_rows_are_filled_from_complete_particulars(invented_run: AnalysedRun, language: str) -> None:
    filled = entries(read_layout(), context(invented_run, fitting(), language))
    assert [entry["key"] for entry in filled if entry["origin"] == "not_determined"] == []
    assert all(entry["value"].strip() for entry in filled)


def test_without_particulars_the_rest_is_marked(invented_run: AnalysedRun) -> None:
    filled = {e["key"]: e for e in entries(read_layout(), context(invented_run, Metadata(date=DAY)))}
    assert len(filled) == 47
    for key in ("camera_model", "lens_serial", "lever_arm", "boresight", "responsible", "pixel_size", "iso"):
        assert filled[key]["origin"] == "not_determined"
        assert filled[key]["value"] == "not determined"
    assert filled["photos"]["value"] == "4"
    assert filled["targets"]["value"] == "7"
    assert filled["readings"]["value"] == "28"


def test_given_numbers_keep_their_digits(invented_run: AnalysedRun) -> None:
    filled = {e["key"]: e["value"] for e in entries(read_layout(), context(invented_run, fitting()))}
    assert filled["exposure_time"] == "0.001"
    assert filled["pixel_size"] == "0.00241"
    assert filled["iso"] == "100"
    assert filled["gsd"] == "2.93"
    portuguese = context(invented_run, fitting(), "pt-BR")
    assert {e["key"]: e["value"] for e in entries(read_layout(), portuguese)}["gsd"] == "2,93"


def test_pictures_tell_exposure_where_nobody_typed_it(invented_run: AnalysedRun, tmp_path: Path) -> None:
    one = {"least": 0.625, "median": 0.625, "most": 0.625}
    counts = dict.fromkeys(("images", "strips", "tilt_over_3_deg", "tilt_over_5_deg", "smear_over_limit"), 0)
    figures: dict[str, Any] = {**counts, "gaps": [], "exposure_ms": one, "iso": None}
    told = read_particulars(None, DAY, flown=figures)
    filled = {e["key"]: e for e in entries(read_layout(), context(invented_run, told))}
    # 1/1600 s.
    assert (filled["exposure_time"]["value"], filled["exposure_time"]["origin"]) == (
        "0.000625 (EXIF)",
        "given",
    )
    assert filled["iso"]["origin"] == "not_determined"
    assert filled["rtk_advice"]["origin"] == "fixed"
    given = tmp_path / "given.toml"
    given.write_text("[campaign]\nexposure_time_s = 0.001\n", encoding="utf-8")
    typed = context(invented_run, read_particulars(given, DAY, flown=figures))
    assert {e["key"]: e["value"] for e in entries(read_layout(), typed)}["exposure_time"] == "0.001"
    given.write_text("[flown]\nimages = 12\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="flown is measured, not given"):
        read_particulars(given, DAY)


def test_interior_orientation_in_millimetres(invented_run: AnalysedRun) -> None:
    """3412.50 px of 2.41 um are 8.2241 mm; K1 = 1.2e-9 px^-2 is 2.066e-4 mm^-2."""
    filled = {e["key"]: e["value"] for e in entries(read_layout(), context(invented_run, fitting()))}
    assert filled["iop_table"].startswith("c 8.2241 ± 0.0010 mm")
    assert "K₁ (2.07 ± 0.34) × 10⁻⁴ mm⁻²" in filled["iop_table"]


def test_corners_in_the_order_of_the_form(invented_run: AnalysedRun) -> None:
    """Upper left, then counter-clockwise; half of 4000 and 3000 times 2.41 um."""
    assert corners(context(invented_run, fitting())) == (
        ("1", "0", "0", "−4.8200", "3.6150"),
        ("2", "0", "3000", "−4.8200", "−3.6150"),
        ("3", "4000", "3000", "4.8200", "−3.6150"),
        ("4", "4000", "0", "4.8200", "3.6150"),
    )


def test_height_and_base_of_a_flown_block_are_computed(invented_run: AnalysedRun) -> None:
    """Exposures stand 30 m apart in a row; the ground sampling distance follows from height and camera."""
    known = derived_figures(invented_run, "l1", Metadata(date=DAY, camera={"pixel_size_mm": 0.00241}))  # type: ignore[arg-type]
    assert known.base_m == pytest.approx(30.0, abs=0.01)
    assert known.height_m is not None
    assert known.gsd_cm == pytest.approx(100 * known.height_m / 3412.5)
    assert known.computed == {"height", "gsd", "base"}


@pytest.mark.shared
def test_a_wall_is_no_flight(published_run: AnalysedRun) -> None:
    known = derived_figures(published_run, "dcs460", Metadata(date=DAY))
    assert (known.height_m, known.gsd_cm, known.base_m) == (None, None, None)
    assert known.pixel_mm == pytest.approx(0.00902847, abs=1e-8)


@pytest.mark.shared
def test_pixel_from_rounded_frame_sizes_is_doubted(published_run: AnalysedRun) -> None:
    """27.6 mm / 3060 over 18.4 mm / 2036 is 0.99804: the error of the published calibration."""
    found = {f.code: f.figures for f in derived_figures(published_run, "dcs460", Metadata(date=DAY)).findings}
    assert found["pitch_not_square"]["percent"] == pytest.approx(0.196, abs=1e-3)


def test_contradicting_particulars_stop_the_certificate(invented_run: AnalysedRun) -> None:
    """The example's sensor is not that of the invented camera: nothing is printed."""
    with pytest.raises(InputMalformedError, match=r"9\.640 × 7\.230 mm; the sensor measures 13\.20 mm"):
        certificate(invented_run, read_particulars(EXAMPLE, DAY), catalogue("en"))


def test_full_certificate_has_all_sections(invented_run: AnalysedRun) -> None:
    document = certificate(invented_run, fitting(), catalogue("en"))
    titles = [section.title for section in document.sections]
    for title in (
        "Plausibility",
        "Limits of acceptance",
        "Positioning system, equipment and validity",
        "Signature",
    ):
        assert title in titles
    assert [one.title for one in document.verdicts].count("Limits of items 2.q and 2.r met") == 1
    pieces = [piece for section in document.sections for piece in section.pieces]
    signature = next(piece for piece in pieces if isinstance(piece, Signature))
    assert signature.lines == ("Maria Exemplo", "Engenheira cartógrafa", "CREA 000000")
    form = next(p for p in pieces if isinstance(p, TablePart) and len(p.rows) == 47)
    assert form.rows[0][2] == "Limits of items 2.q and 2.r met"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[camera]\nmodell = 'x'", "camera.modell"),
        ("[campaign]\ngsd_cm = -1", "campaign.gsd_cm"),
        ("[gnss_ins]\nlever_arm_cm = [1, 2]", "gnss_ins.lever_arm_cm"),
        ("date = 2020-01-01", "date"),
        ("document = 3", "document"),
        ("[camera", "not valid TOML"),
    ],
)
def test_wrong_particulars_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError, match=message) as failure:
        read_particulars(path, DAY)
    assert "\n" not in str(failure.value)


def test_missing_particulars(tmp_path: Path) -> None:
    with pytest.raises(InputNotFoundError):
        read_particulars(tmp_path / "none.toml", DAY)


@pytest.mark.parametrize("language", ["en", "pt-BR"])
def test_the_form_is_filled_in_where_it_is_asked_for(invented_run: AnalysedRun, language: str) -> None:
    """Elsewhere nobody is told what the Brazilian ministry does not know."""
    say = catalogue(language)

    def titles(form: str) -> list[str]:
        """Titles of a certificate of which nobody has stated anything."""
        return [
            one.title
            for one in certificate(invented_run, read_particulars(None, DAY, form=form), say).sections
        ]

    asked = [say(f"{key}.section") for key in ("acceptance", "equipment", "ministry")]
    assert [title for title in titles("br-md") if title not in titles("")] == asked
    with pytest.raises(ConfigurationError, match="form"):
        read_particulars(None, DAY, form="br")


def test_what_nobody_stated_is_one_line(invented_run: AnalysedRun) -> None:
    say = catalogue("en")
    made = certificate(invented_run, read_particulars(None, DAY, client="Mapping Ltd"), say)
    (laboratory,) = [one for one in made.sections if one.title == say("laboratory.section")]
    rows = next(piece for piece in laboratory.pieces if isinstance(piece, KeyValues)).rows
    assert ("Customer", "Mapping Ltd") in rows
    (unstated,) = [
        piece.text
        for piece in laboratory.pieces
        if isinstance(piece, Paragraph) and piece.text.startswith("Not stated: ")
    ]
    assert "Laboratory, Place of the work" in unstated
    assert not {name for name, _ in rows} & set(unstated.removeprefix("Not stated: ").rstrip(".").split(", "))
