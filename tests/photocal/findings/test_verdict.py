"""One verdict: what is grave withholds, what is doubtful is a reservation, a small factor is nothing."""

from __future__ import annotations

import json

import pytest

from photocal.findings.finding import Finding, Severity, Size, of_global_test
from photocal.findings.texts import catalogue, finding_json, finding_text, findings_of
from photocal.findings.verdict import (
    MOST_LINES,
    every_line,
    headline,
    judge,
    line_text,
    neighbours,
    read_verdict,
    verdict_json,
    verdict_text,
)


@pytest.mark.parametrize(
    ("severities", "code"),
    [
        ((), "usable"),
        (("note", "passed", "untested"), "usable"),
        (("note", "doubtful"), "usable-with-reservations"),
        (("consequence",), "usable-with-reservations"),
        (("doubtful", "grave"), "not-usable"),
        (("refused",), "not-usable"),
    ],
)
def test_the_gravest_decides(severities: tuple[Severity, ...], code: str) -> None:
    assert judge(Finding("time-offset", one) for one in severities).outcome.code == code


def test_what_several_stages_tell_is_counted_once() -> None:
    told = Finding("rolling-shutter", "grave", "cam"), Finding("rolling-shutter", "grave", "cam")
    assert judge(told).outcome.figures["n"] == 1.0


def test_a_factor_of_five_per_cent_is_no_finding() -> None:
    """The demonstration: 0.991, rejected for its many observations."""
    dof = 100_000
    assert of_global_test(0.991 * dof, dof, accepted=False).severity == "passed"
    assert of_global_test(1.049**2 * dof, dof, accepted=False).severity == "passed"
    assert of_global_test(1.051**2 * dof, dof, accepted=False).severity == "doubtful"
    assert of_global_test(0.949**2 * dof, dof, accepted=False).severity == "doubtful"
    assert of_global_test(4.0 * 10, 10, accepted=True).severity == "passed"


def test_sigmas_of_the_same_residuals_test_nothing() -> None:
    finding = of_global_test(4.0 * 1000, 1000, accepted=False, estimated=True)
    assert finding.severity == "untested"
    assert "no global test is claimed" in finding_text(finding, catalogue("en"))
    assert judge([finding]).outcome.code == "usable"


def test_without_redundancy_nothing_is_tested() -> None:
    assert of_global_test(0.0, 0, accepted=None).severity == "untested"


EN = catalogue("en")


def image(name: str, times: float, severity: Severity = "doubtful") -> Finding:
    figures = {"name": name, "relative": times, "px": 0.3 * times}
    return Finding("image", severity, name, figures, ("amount",), Size(times, "1", px=0.3 * times))


def test_a_factor_above_one_and_a_half_is_not_usable() -> None:
    """However the cause is called: the standard deviations say nothing then."""
    dof = 1000
    assert of_global_test(1.49**2 * dof, dof, accepted=False).severity == "doubtful"
    assert judge([of_global_test(1.51**2 * dof, dof, accepted=False)]).outcome.code == "not-usable"
    assert judge([of_global_test(30_973.0 * dof, dof, accepted=False)]).block == "no"


@pytest.mark.parametrize(
    ("code", "terms", "answer"),
    [
        ("not-separated", ("c", "shift_z"), "on-heights"),
        ("not-determined", ("c",), "on-heights"),
        ("not-determined", ("time_offset",), "yes"),
    ],
)
def test_a_camera_whose_c_the_heights_hold_is_not_carried_without_a_word(
    code: str, terms: tuple[str, ...], answer: str
) -> None:
    told = Finding(code, "note", " ".join(terms), {"terms": terms}, clauses=("add-control",))
    verdict = judge([told])
    # A run reads it back from what the check has stored.
    stored = json.loads(json.dumps([finding_json(told, EN)]))
    assert judge(findings_of(stored, "check.json")).camera == verdict.camera
    assert (verdict.camera, verdict.outcome.code, verdict.lines) == (answer, "usable", ())
    assert ("heights" in headline(verdict, EN)) == (answer == "on-heights")


def test_a_block_on_positions_alone_is_not_called_tested() -> None:
    notes = [Finding("no-control", "note"), Finding("no-check-points", "note")]
    verdict = judge(notes)
    assert (verdict.block, verdict.outcome.code) == ("on-positions", "usable")
    assert "as accurately as its positions" in headline(verdict, EN)
    assert "No action" not in headline(verdict, EN)
    # Check points, or control, test where it lies; what is wrong is said before.
    assert [judge([note]).block for note in notes] == ["yes", "yes"]
    assert (
        judge([*notes, Finding("check-mean", "doubtful", "indirect", {"method": "indirect"})]).block
        == "reserved"
    )


def test_each_sentence_of_a_verdict_stands_once() -> None:
    worst = Finding("block-not-placed", "doubtful", clauses=())
    for findings in ([worst], [image("a.jpg", 1.6)], [worst, image("a.jpg", 1.6)]):
        said = " ".join(verdict_text(judge(findings), EN))
        sentences = [part.strip(" .") for part in said.replace("First: ", "").split(". ")]
        assert len(sentences) == len(set(sentences)) > 2


@pytest.mark.parametrize(
    ("language", "also"), [("en", "The same: indirect."), ("pt-BR", "O mesmo: indireto.")]
)
def test_biased_check_points_are_told_once_for_both_methods(language: str, also: str) -> None:
    told = [
        Finding("check-mean", "doubtful", method, {"method": method, "numbers": (f"Z +0.18{k} +- 0.030",)})
        for k, method in enumerate(("integrated", "indirect"))
    ]
    _, *lines = verdict_text(judge(told), catalogue(language))
    assert len(lines) == 1
    assert also in lines[0]


def test_alike_findings_are_one_line_with_their_neighbours() -> None:
    names = [f"DJI_20260314_{k:04d}" for k in (3, 572, 573, 574, 575, 580, 654)]
    given = [image(name, 1.2 + 0.05 * k) for k, name in enumerate(names)]
    (line,) = judge(given, images=581).lines
    text = line_text(line, EN)
    assert "7 of 581 images scatter 1.2 to 1.5 times" in text
    assert "the worst DJI_20260314_0654" in text
    assert "DJI_20260314_0572 … DJI_20260314_0575" in text
    assert "0580 …" not in text


def test_neighbours_are_three_that_follow_each_other() -> None:
    assert neighbours(["a7", "a8", "b9", "a10", "c"]) == []
    assert neighbours(["img_099.jpg", "img_101.jpg", "img_100.jpg"]) == ["img_099.jpg … img_101.jpg"]


def test_seven_lines_and_how_many_more() -> None:
    given = [Finding("unknown-frame", "doubtful", str(k), cause=f"c{k}") for k in range(3)]
    codes = ("lever-arm", "boresight", "time-offset", "datum-shift", "strip-shifts", "no-control", "smear")
    given += [Finding(code, "grave") for code in codes]
    made = judge(given)
    assert len(made.lines) == MOST_LINES
    assert made.beyond == 3
    # What is grave comes first.
    assert all(line.worst.severity == "grave" for line in made.lines)


def test_a_cause_stands_before_what_it_does() -> None:
    figures = {"camera": "cam", "bias": 0.05, "unit": "mm", "share": 1e-3}
    given = [Finding("c-bias", "grave", "cam", figures), Finding("lever-arm", "doubtful")]
    assert [line.worst.code for line in judge(given).lines] == ["lever-arm", "c-bias"]
    assert "Measure the lever arm again" in headline(judge(given), EN)


def test_a_grave_misfit_stands_before_single_marks() -> None:
    ratio = {"method": "indirect", "ratio": 3.2}
    given = [
        Finding("one-image-only", "doubtful", "control"),
        Finding("prediction-too-good", "grave", "x", ratio),
    ]
    given.append(Finding("unexplained", "doubtful"))
    codes = [line.worst.code for line in judge(given).lines]
    assert codes == ["unexplained", "prediction-too-good", "one-image-only"]


def test_what_only_a_carried_camera_feels_does_not_touch_the_block() -> None:
    figures = {"camera": "cam", "bias": 0.02, "unit": "mm", "share": 1e-3}
    made = judge([Finding("c-bias", "doubtful", "cam", figures, ("only_carried",))])
    assert (made.block, made.camera) == ("yes", "reserved")
    points = {"method": "direct", "points": ("p1",)}
    made = judge([Finding("check-outside-prediction", "doubtful", "direct", points)])
    assert (made.block, made.camera) == ("reserved", "yes")
    assert judge([Finding("lever-arm", "grave")]).camera == "no"


@pytest.mark.parametrize(
    ("finding", "answer"),
    [
        (Finding("camera-held", "doubtful", "cam", {"names": ("c", "x0")}), "except-c"),
        (Finding("camera-held", "doubtful", "cam", {"names": ("K3",)}), "reserved"),
        (Finding("weak_principal_distance", "doubtful", "c", {"percent": 6.1}), "except-c"),
        (Finding("camera-held", "consequence", "cam", {"names": ("c",)}), "except-c"),
    ],
)
def test_a_principal_distance_that_the_flight_leaves_open_is_not_carried(
    finding: Finding, answer: str
) -> None:
    stored = json.loads(json.dumps([finding_json(finding, EN)]))
    for found in ([finding], list(findings_of(stored, "calibration.json"))):
        made = judge(found)
        assert (made.camera, made.block, made.outcome.code) == (answer, "yes", "usable-with-reservations")
        assert ("except its principal distance" in headline(made, EN)) == (answer == "except-c")


def test_a_free_block_is_calibrated_and_not_placed() -> None:
    made = judge([], placed=False)
    assert (made.block, made.camera) == ("not-placed", "yes")
    assert "not georeferenced" in headline(made, EN)
    assert judge([], calibrated=False).camera == "held"


def test_effects_are_in_units_that_can_be_read() -> None:
    def effect(metres: float | None, px: float | None = None) -> str:
        finding = Finding("lever-arm", "grave", size=Size(1.0, "m", ground_m=metres, px=px))
        return line_text(judge([finding]).lines[0], EN)

    assert "Effect: 1.2 cm on the ground." in effect(0.0123)
    assert "Effect: 1.50 m on the ground." in effect(1.5)
    assert "Effect: < 0.1 cm on the ground." in effect(1e-9)
    assert "Effect: 0.85 px in the image." in effect(None, 0.849)
    assert "Effect" not in effect(None)


@pytest.mark.parametrize("language", ["en", "pt-BR"])
def test_each_verdict_is_said_in_both_languages_and_read_back(language: str) -> None:
    say = catalogue(language)
    given = [image("a1", 1.3), image("a2", 1.6), Finding("lever-arm", "grave")]
    made = judge(given, 12)
    stored = verdict_json(made, say)
    assert verdict_json(read_verdict(stored, "here"), say) == stored
    assert [stored["paragraph"], *stored["said"]] == verdict_text(made, say)
    assert stored["code"] == "not-usable"


def test_older_verdicts_have_an_outcome_alone() -> None:
    old: dict[str, object] = {"code": "usable", "severity": "passed", "subject": "", "clauses": []}
    old |= {
        "figures": {"n": 0.0},
        "size": None,
        "cause": "",
        "remedy": "",
        "stage": "",
        "text": "Verdict: usable",
    }
    assert read_verdict(old, "here").block == "unknown"
    assert headline(read_verdict(old, "here"), EN) == "No action is needed."


def test_what_two_methods_show_is_said_once_with_both() -> None:
    """Points that fit neither direct nor integrated are said once, and what fits one alone beside them."""

    def shown(method: str, *points: str) -> Finding:
        figures = {"method": method, "points": points}
        return Finding("check-outside-prediction", "doubtful", method, figures)

    alike = judge([shown("direct", "p4", "p7"), shown("integrated", "p4", "p7")])
    said = verdict_text(alike, catalogue("en"))[1:]
    assert [line.partition(" differs")[0] for line in said] == ["Direct and integrated: check point p4, p7"]
    apart = judge([shown("direct", "p4"), shown("integrated", "p4", "p9"), shown("indirect", "p9")])
    said = verdict_text(apart, catalogue("pt-BR"))[1:]
    assert [line.count("p4") for line in said] == [1, 0]
    assert [line.count("p9") for line in said] == [0, 1]
    # A certificate tells these lines again beside the findings of its stages.
    raw = [shown("integrated", "p1", "p5"), shown("indirect", "p1", "p3", "p5")]
    again = every_line([*raw, *(line.worst for line in judge(raw).lines)])
    assert [line.worst.figures["points"] for line in again] == [("p1", "p5"), ("p3",)]
    assert [line.worst.figures["method"] for line in again] == [("integrated", "indirect"), ("indirect",)]
    refused = [
        Finding("method-refused", "grave", method, {"method": method, "reason": f"why {method}"})
        for method in ("integrated", "indirect")
    ]
    (line,) = verdict_text(judge(refused), catalogue("en"))[1:]
    assert line.startswith("Integrated and indirect georeferencing is not possible")
