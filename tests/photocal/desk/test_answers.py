"""What the window answers: folders, the form of the project, checks, a run that is stopped, certificates."""

from __future__ import annotations

import io
import json
import math
import os
import shutil
import time
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.desk import project_file
from photocal.desk.jobs import FOLDER, Job, error_of
from photocal.desk.running import told_stages
from photocal.findings.finding import Finding
from photocal.run.debrief.verdict import Debrief, debrief_json
from tests.conftest import Once
from tests.photocal.desk.client import Answer, Client, opened
from tests.photocal.desk.conftest import HOSTILE, fresh
from tests.photocal.run.typed_site import resized

PATIENCE_S = 240.0


def until(asked: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not asked():
        assert time.monotonic() < end, what
        time.sleep(0.1)


def good(answer: Answer) -> Answer:
    assert answer.status == 200, answer.text
    return answer


def test_folders_are_listed_with_what_they_hold_and_none_outside(window: Client, home: Path) -> None:
    (home / "out").symlink_to("/")
    told = good(window.get("/api/folders?path=")).json
    assert told["up"] is None
    assert [entry["name"] for entry in told["folders"]] == [HOSTILE, "site"]
    inner = good(window.get("/api/folders?path=site/images")).json
    assert (inner["up"], inner["here"]["pictures"]) == ("site", 8)


@pytest.mark.parametrize("path", ["..", "../..", "/etc", "site/../../..", "out/etc", "site\0", "%2e%2e"])
def test_nothing_outside_of_the_folder_is_opened(window: Client, home: Path, path: str) -> None:
    (home / "out").symlink_to("/")
    answer = window.post("/api/open", {"path": path})
    assert answer.status == 404, answer.text
    assert good(window.get("/api/desk")).json["folder"] == "."


@pytest.mark.parametrize(
    "path", ["/../server.py", "/vendor/../server.py", "/page/index.html", "/vendor.toml"]
)
def test_only_files_of_the_page_are_served(window: Client, path: str) -> None:
    assert window.get(path).status == 404


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "evil.example"}, 403),
        ({"Origin": "https://evil.example"}, 403),
        ({"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}, 403),
        ({"content-type": "text/plain"}, 422),
        ({}, 422),
    ],
)
def test_no_other_site_makes_the_window_do_anything(
    window: Client, headers: dict[str, str], status: int
) -> None:
    for path in ("/api/run/start", "/api/open", "/api/set", "/api/certificate/sign"):
        answer = window.ask(path, "POST", b'{"path": "site"}', headers)
        assert answer.status == status, path


def test_the_page_forbids_foreign_code_and_a_certificate_has_a_stricter_rule(window: Client) -> None:
    policy = window.get("/").headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "http:" not in policy


def test_questions_longer_than_any_are_refused(window: Client) -> None:
    assert window.post("/api/open", {"path": "x" * 20_000}).status == 422
    assert window.post("/api/set", {"key": "project.crs", "value": "x" * 1000}).status == 422


PROJECT = """\
# My own remark.
[project]
name = "field"  # as the client calls it
crs = "?"
height = "?"
output = "work"

[images]
folder = "images"
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "project.toml"
    path.write_text(PROJECT)
    return path


def test_what_is_asked_is_said_of_its_field(file: Path) -> None:
    fields = {field["key"]: field for field in project_file.shown(file)["fields"]}
    assert fields["project.crs"]["asked"]
    assert fields["project.height"]["asked"]
    assert not fields["project.name"]["asked"]
    assert fields["project.name"]["comment"] == "as the client calls it"
    assert project_file.shown(file)["problem"]["field"] in ("project.crs", "project.height")


def test_a_value_is_changed_and_all_else_stays(file: Path) -> None:
    project_file.put(file, "project.crs", "EPSG:2180")
    project_file.put(file, "project.height", "orthometric")
    project_file.put(file, "certificate.client", 'Mapping "Ltd"')
    text = file.read_text()
    assert text.startswith("# My own remark.\n")
    assert "# as the client calls it" in text
    assert tomllib.loads(text)["project"] == {
        "name": "field",
        "crs": "EPSG:2180",
        "height": "orthometric",
        "output": "work",
    }
    assert tomllib.loads(text)["certificate"] == {"client": 'Mapping "Ltd"'}
    project_file.put(file, "certificate.client", "")
    assert "client" not in tomllib.loads(file.read_text())["certificate"]
    assert project_file.shown(file)["problem"] is None


def test_local_coordinates_are_one_answer(file: Path) -> None:
    project_file.put(file, "project.crs", "local")
    assert tomllib.loads(file.read_text())["project"]["height"] == "local"
    project_file.put(file, "project.height", "ellipsoidal")
    assert tomllib.loads(file.read_text())["project"]["crs"] == "?"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("project.crs", "EPSG:999999"),
        ("project.height", "high"),
        ("images.lens", "glass"),
        ("images.position_sigma_m", [1.0, -1.0, 1.0]),
        ("project.output", "/"),
        ("images.folder", ".."),
    ],
)
def test_what_cannot_be_is_not_written(file: Path, key: str, value: object) -> None:
    from photocal.base.errors import ConfigurationError

    with pytest.raises(ConfigurationError):
        project_file.put(file, key, value)
    assert file.read_text() == PROJECT


def test_roles_of_points_change_and_their_table_stays(tmp_path: Path) -> None:
    path = tmp_path / "control.csv"
    path.write_text('point,X,Y,Z,sX,sY,sZ,role\n"G,1",1,2,3,0.1,0.1,0.1,control\nG2,4,5,6,,,,control\n')
    project_file.put_role(path, "G,1", "check")
    assert path.read_text().splitlines()[1:] == [
        '"G,1",1,2,3,0.1,0.1,0.1,check',
        "G2,4,5,6,,,,control",
    ]


@pytest.mark.parametrize(
    ("error", "field"),
    [
        ("crs = 'EPSG:2180+5773' needs us_nga_egm96_15.tif, which is not installed", "project.crs"),
        ("project: crs = '?' is still to be filled in", "project.crs"),
        ("project: height = '?' is still to be filled in", "project.height"),
        ("rig.camera_to_antenna_m: value is not a valid tuple", "rig.camera_to_antenna_m"),
        ("the disk is full", ""),
    ],
)
def test_an_error_is_said_of_the_field_that_mends_it(error: str, field: str) -> None:
    assert project_file.field_of(error) == field


def test_lines_of_a_run_tell_its_stages() -> None:
    log = "a: b: measurements: 3.1 s\nmatching: 41%, 46 s left\na: b: block: kept\n"
    assert told_stages(log, ["measurements", "block", "calibration"]) == {
        "measurements": "made",
        "block": "kept",
    }
    assert error_of("x\nerror: it is so\n  because\n") == "it is so\nbecause"


def test_progress_of_hours_crowds_no_stage_out_of_the_log(tmp_path: Path) -> None:
    told = '{"progress": {"stage": "measurements", "title": "matching pairs of images", "share": 0.5}}\n'
    (tmp_path / FOLDER).mkdir()
    (tmp_path / FOLDER / "run.log").write_text(f"a: ppk: 3.1 s\n{9000 * told}a: exposures: 1.0 s\n")
    assert Job(tmp_path, "run").log() == "a: ppk: 3.1 s\na: exposures: 1.0 s\n"


def test_the_command_tells_how_the_steps_stand(
    photocal: Callable[..., Any], home: Path, tmp_path: Path
) -> None:
    said = photocal("desk", home / "site", "--json")
    assert said.code == 0
    assert json.loads(said.out)["steps"]["folder"] == {"state": "none", "word": "stands.choose"}
    missing = photocal("desk", tmp_path / "nowhere")
    assert (missing.code, "is not a folder" in missing.err) == (3, True)


def test_marks_are_adjusted_after_a_run_without_a_geoid(finished: Path, tmp_path: Path) -> None:
    """Heights of the map count from nobody knows where; the marks have a sigma of 0.2 px."""
    folder = Path(shutil.copytree(finished, tmp_path / "site"))
    with opened(folder, tmp_path / "cache") as client:
        told = good(client.get("/api/mark/images?point=G5")).json
        assert told["source"] == "adjustment"
        marks = client.get("/api/mark/state").json["marks"]
        adjusted = good(client.post("/api/mark/adjust")).json
    assert len(adjusted["residuals"]) == len(marks) > 20
    assert adjusted["left_out"] == []
    lengths = [math.hypot(one["vx"], one["vy"]) for one in adjusted["residuals"]]
    assert max(lengths) < 5 * 0.2
    assert sum(length**2 for length in lengths) / len(lengths) < 2 * 0.2**2


def test_sizes_of_marks_are_shown_in_the_pictures_and_chosen(window: Client, home: Path, once: Once) -> None:
    folder = fresh(once, home / "half", "desk-half", change=resized(0.5))
    good(window.post("/api/open", {"path": "half"}))
    told = good(window.post("/api/new")).json["said"]
    assert [told["frames"][0][key] for key in ("frame", "chosen")] == ["1/2", True]
    converted = (folder / "marks.csv").read_text()
    # The height is still asked for; the pictures are seen all the same.
    mark = told["frames"][0]["marks"][0]
    assert good(window.get(f"/api/tiles/{mark['image']}/0/0/0")).headers["content-type"] == "image/jpeg"
    chosen = good(window.post("/api/new", {"marks": "1"})).json["said"]
    assert (chosen["marks"], chosen["frames"]) == ("1", told["frames"])
    assert (folder / "marks.csv").read_text() != converted
    # It stays chosen when the folder is looked at again.
    assert good(window.post("/api/new")).json["said"]["marks"] == "1"
    assert good(window.post("/api/new", {"marks": "1/2"})).json["said"]["marks"] == "1/2"
    assert (folder / "marks.csv").read_text() == converted


def test_points_of_a_local_system_lie_on_the_map_to_be_made_check_points(
    window: Client, home: Path, once: Once
) -> None:
    fresh(once, home / "local", "desk-half", change=resized(0.5))
    good(window.post("/api/open", {"path": "local"}))
    good(window.post("/api/new", {"crs": "local"}))
    told = good(window.get("/api/places")).json
    assert len(told["points"]) == 6
    metres = np.array([point["xyz"][:2] for point in told["points"]])
    # On the equator a degree of the map is 111 319.5 m.
    drawn = 111319.5 * np.array([point["place_deg"] for point in told["points"]])
    assert drawn - drawn[0] == pytest.approx(metres - metres[0], abs=1e-3)
    name = told["points"][0]["name"]
    changed = good(window.post("/api/role", {"point": name, "role": "check"})).json
    assert {point["name"]: point["role"] for point in changed["points"]}[name] == "check"


def test_systems_are_found_by_name_number_and_country(window: Client) -> None:
    def codes(text: str) -> list[str]:
        found = good(window.get(f"/api/systems?text={text}")).json["systems"]
        return [entry["code"] for entry in found]

    assert codes("puwg1992")[0] == "EPSG:2180"
    assert codes("2180")[0] == "EPSG:2180"
    assert "EPSG:31982" in codes("SIRGAS%202000%20UTM%2022S")
    assert codes("nothing%20of%20the%20kind") == []


def test_a_job_outlives_the_window_and_is_not_begun_twice(tmp_path: Path) -> None:
    """The process is another window's child: what it is, is told by its number and its birth."""
    job = Job(tmp_path, "run")
    assert job.state()["state"] == "none"
    site = tmp_path / "images"
    site.mkdir()
    job.start(["debrief", tmp_path, "--live"], "photocal debrief . --live")
    other = Job(tmp_path, "run")
    told = json.loads((tmp_path / FOLDER / "run.json").read_text())
    # It fails, for there is no project: the error is that of the command, for both.
    until(lambda: other.state()["state"] == "failed", "the end of the command")
    assert "project.toml" in other.state()["error"]
    # Who waits for the process itself hears of its end when its last thread has gone.
    until(lambda: job.state() == other.state(), "the same state for both")
    # A number that another process has by now is not that process.
    told |= {"pid": os.getpid(), "born": "1"}
    (tmp_path / FOLDER / "run.json").write_text(json.dumps(told))
    assert Job(tmp_path, "run").state()["state"] == "failed"


def test_a_run_is_stopped_and_begun_again(window: Client, home: Path) -> None:
    good(window.post("/api/open", {"path": "site"}))
    good(window.post("/api/new", {"height": "orthometric"}))
    good(window.post("/api/run/start"))
    assert window.post("/api/run/start").status == 422
    until(lambda: (home / "site" / "work" / ".lock").exists(), "work to begin")
    stopped = good(window.post("/api/run/stop")).json
    assert (stopped["job"]["state"], stopped["error"]) == ("stopped", None)
    assert good(window.get("/api/desk")).json["steps"]["run"]["word"] == "stands.stopped"
    # Nothing holds the folder any more, and nothing half made takes the place of a stage.
    assert all((stage / "stage.json").is_file() for stage in (home / "site/work/.stages").glob("[a-z]*/"))
    assert good(window.post("/api/run/start")).json["job"]["state"] == "busy"
    good(window.post("/api/run/stop"))


def test_a_run_waits_for_the_debrief_that_works_in_its_folder(window: Client) -> None:
    good(window.post("/api/open", {"path": "site"}))
    good(window.post("/api/new", {"height": "orthometric"}))
    assert not good(window.get("/api/run")).json["debriefing"]
    # It follows the card until it is stopped.
    good(window.post("/api/debrief/start", {"live": True}))
    assert good(window.get("/api/run")).json["debriefing"]
    good(window.post("/api/debrief/stop"))
    assert not good(window.get("/api/run")).json["debriefing"]
    good(window.post("/api/run/start"))
    assert good(window.get("/api/check")).json["running"]
    good(window.post("/api/run/stop"))


def test_a_certificate_is_filled_in_issued_signed_sent_and_verified(
    window: Client, home: Path, finished: Path
) -> None:
    """Particulars, preview, key, issue, signature, zip, and the same zip verified."""
    folder = Path(shutil.copytree(finished, home / "flown"))
    good(window.post("/api/open", {"path": "flown"}))
    told = good(window.get("/api/run")).json
    assert {stage["state"] for stage in told["stages"]} == {"there"}
    values = {"camera.serial": HOSTILE, "conditions.temperature_c": "21,5", "validity.until": "2031-01-31"}
    form = {"values": values, "client": HOSTILE, "operator": "", "language": "en"}
    good(window.post("/api/certificate/preview", form))
    framed = good(window.get("/certificate/preview"))
    assert HOSTILE.encode() not in framed.body
    assert b"&lt;img src=x" in framed.body
    assert framed.headers["content-security-policy"].endswith("sandbox")
    assert not (folder / "particulars.toml").exists()
    wrong = window.post("/api/certificate/preview", {**form, "values": {"validity.until": "soon"}})
    assert (wrong.status, "not a day" in wrong.text) == (422, True)
    good(window.post("/api/certificate/set", form))
    assert tomllib.loads((folder / "particulars.toml").read_text())["conditions"] == {"temperature_c": 21.5}
    good(window.post("/api/certificate/key", {"name": "Office for tests"}))
    good(window.post("/api/run/start"))
    until(lambda: good(window.get("/api/run")).json["job"]["state"] != "busy", "the certificate")
    states = {stage["name"]: stage["state"] for stage in good(window.get("/api/run")).json["stages"]}
    assert states.pop("certificate") == "made"
    assert set(states.values()) == {"kept"}
    signed = good(window.post("/api/certificate/sign")).json
    assert signed["issued"]["signed"]
    assert good(window.get("/api/desk")).json["steps"]["certificate"]["word"] == "stands.signed"
    packed = good(window.get("/certificate/zip"))
    told = verified(window, packed.body)
    assert (told["verified"], told["authentic"]) == (True, True)
    assert told["signature"]["name"] == "Office for tests"
    # One figure changed: neither what was signed, nor what the inputs give.
    told = verified(window, changed(packed.body))
    assert (told["verified"], told["authentic"]) == (False, False)


def test_verdict_and_debrief_are_said_in_the_language_of_the_window(
    window: Client, home: Path, finished: Path
) -> None:
    folder = Path(shutil.copytree(finished, home / "flown"))
    good(window.post("/api/open", {"path": "flown"}))
    complete = Debrief(Finding("flight-complete", "passed"), (), ())
    (folder / "work" / "debrief.json").write_text(json.dumps(debrief_json(complete)))

    def told(language: str) -> tuple[str, str, str, str]:
        good(window.post("/api/language", {"language": language}))
        flown = good(window.get("/api/check")).json["debrief"]
        certificate = good(window.get("/api/certificate")).json
        # What is offered for the certificate, until a language is chosen.
        assert certificate["language"] == language
        issued = certificate["issued"]["verdict"]
        of_run = good(window.get("/api/run")).json["verdict"]
        assert of_run == issued
        return of_run["paragraph"], " ".join(of_run["said"]), flown["verdict"]["text"], flown["summary"][0]

    # What a command has said in another language is no longer shown.
    good(window.post("/api/check/start"))
    machine = good(window.get("/api/check")).json["checked"]["machine"]
    assert "clock" in {one["part"] for one in machine}
    english, portuguese = told("en"), told("pt-BR")
    assert good(window.get("/api/check")).json["checked"] is None
    assert ["block" in english[0], "bloco" in portuguese[0]] == [True, True]
    assert "flight is complete" in english[2]
    assert "voo está completo" in portuguese[2]
    assert (english[3], portuguese[3]) == ("0 of 0 pictures can be read", "0 de 0 imagens podem ser lidas")
    assert window.post("/api/language", {"language": "xx"}).status == 422


def test_refusals_are_in_the_language_of_the_page(window: Client) -> None:
    english = window.post("/api/open", {"path": "nowhere"}).json["error"]
    assert english.endswith("; choose from the list")
    good(window.post("/api/language", {"language": "pt-BR"}))
    assert window.post("/api/open", {"path": "nowhere"}).json["error"].endswith("; escolha da lista")
    # A field knows its error, whichever language says it.
    good(window.post("/api/open", {"path": "site"}))
    form = good(window.post("/api/new", {})).json["form"]
    assert form["problem"]["field"] == "project.height"
    assert "ainda está por preencher" in form["problem"]["text"]


def verified(window: Client, octets: bytes) -> dict[str, Any]:
    answer = good(window.ask("/api/verify", "POST", octets, {"content-type": "application/zip"}))
    return dict(answer.json)


def changed(octets: bytes) -> bytes:
    """The same zip with another number of observations in its record."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(octets)) as given, zipfile.ZipFile(made, "w") as other:
        for name in given.namelist():
            content = given.read(name)
            if name == "certificate.json":
                record = json.loads(content)
                record["result"]["observations"] += 2
                content = json.dumps(record).encode()
            other.writestr(name, content)
    return made.getvalue()


@pytest.mark.parametrize(
    "name", ["../evil.txt", "/evil.txt", "a/../../evil.txt", "C:evil.txt", "..\\evil.txt"]
)
def test_a_zip_that_reaches_out_is_refused(window: Client, name: str) -> None:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr("certificate.json", "{}")
        archive.writestr(name, "evil")
    answer = window.ask("/api/verify", "POST", made.getvalue(), {"content-type": "application/zip"})
    assert answer.status == 422
    assert "outside" in answer.text


def test_what_is_no_zip_of_a_certificate_is_refused(window: Client) -> None:
    headers = {"content-type": "application/zip"}
    assert "is not a zip" in window.ask("/api/verify", "POST", b"x" * 100, headers).text
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr("readme.txt", "hello")
    assert "certificate.json" in window.ask("/api/verify", "POST", made.getvalue(), headers).text
    assert window.ask("/api/verify", "POST", made.getvalue(), {"content-type": "text/plain"}).status == 422
