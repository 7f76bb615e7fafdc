"""`photocal new`, `adopt`, `run`, `debrief`: commands on a whole project.

`photocal desk`: one window from the folder to the signed certificate.
"""

import json
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from photocal.base.console import Address, AsJson, Details, Language, answer, argument, option, printable
from photocal.base.progress_bars import OF_RUN, ON_BAR, one_bar, progress, while_starting

if TYPE_CHECKING:
    from photocal.findings.texts import Catalogue
    from photocal.geometry.camera import Camera
    from photocal.run.debrief.verdict import Debrief


def new(
    folder: Annotated[
        Path, argument("Folder of a flight: pictures, control, marks, logs.", metavar="FOLDER")
    ],
    crs: Annotated[
        str, option("Coordinate system of the control points if their file states none: code or name.")
    ] = "",
    height: Annotated[str, option("Height kind of the control points: ellipsoidal or orthometric.")] = "",
    marks: Annotated[
        str,
        option("Size (1/2), rotation (exif, 90) or axes (bottom, swapped) of the marks; or fraction."),
    ] = "",
    again: Annotated[
        bool, option("Keep the answers and comments of project.toml and add new findings.", "--again")
    ] = False,
    language: Language = "",
    as_json: Annotated[bool, option("Print what was found as JSON.", "--json")] = False,
) -> None:
    """Inspect a folder and write its project.toml; list what was found and what is missing.

    Example: `photocal new flight`, then `photocal run flight/project.toml`
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.run.new_project import new_project

    say = catalogue((language or "en") if as_json else spoken(language))
    made = new_project(folder, crs, height, marks, say.language, again=again)
    parts = {"found": made.known, "missing": made.missing, "doubtful": made.doubtful, "asked": made.asked}
    if again:
        parts["changed"] = list(made.changes)
    words = {part: say(f"new.part.{part}") for part in parts}
    rows = {"read": made.rows, "used": made.rows_used, "not_used": made.refused}
    marked = {"rows": rows, "frames": list(made.offers)}
    answer(
        as_json,
        lambda: {"schema": "photocal.new/1", "project": str(made.path), **parts, **marked},
        lambda: "\n".join(
            [
                *(f"{words[part]}: {line}" for part, lines in parts.items() for line in lines),
                say("new.next_asked" if made.asked else "new.next", path=made.path),
            ]
        ),
    )


def adopt(
    project: Annotated[Path, argument("Folder of the project, or its set-up file.", metavar="PROJECT")],
    output: Annotated[Path, option("Folder for block, run and certificate.", "-o", "--output")],
    gcp: Annotated[Path | None, option("gcp_list.txt for a project without control.")] = None,
    language: Language = "",
    as_json: Annotated[bool, option("Print adoption.json.", "--json")] = False,
) -> None:
    """Adjust a project of Pix4D, Metashape, ODM, OpenSfM, COLMAP or MicMac again and compare.

    Example: `photocal adopt field/1_initial/params -o second-opinion`
    """
    import datetime as dt

    from photocal.base.operating_system import keep_memory
    from photocal.findings.texts import catalogue, spoken
    from photocal.run.adopt import adopt as adopted
    from photocal.run.adoption_figures import adoption_text

    keep_memory()
    say = catalogue(spoken(language))
    figures = adopted(project, output, dt.datetime.now().astimezone().date(), progress, gcp)
    answer(
        as_json,
        lambda: figures,
        lambda: adoption_text(figures, say) + "\n" + say("adopted.written", place=output),
    )


def run(
    projects: Annotated[
        list[Path],
        argument("Project files, or their folders; several run one after another.", metavar="PROJECT"),
    ],
    until: Annotated[str | None, option("Last stage to run.")] = None,
    again: Annotated[
        str | None, option("Force this stage to run again, although nothing has changed.")
    ] = None,
    rehash: Annotated[
        bool, option("Hash all files again, even if their sizes and times are unchanged.", "--rehash")
    ] = False,
    workers: Annotated[int, option("Number of projects to process in parallel.", min=1)] = 1,
    cluster: Annotated[str | None, option("Dask scheduler that runs the projects: tls://HOST:PORT.")] = None,
    language: Language = "",
    details: Details = False,
    as_json: AsJson = False,
) -> None:
    """Process a flight: PPK, exposures, image points, calibration, check points, analysis, certificate.

    A flight log is optional: pictures alone, or with control points or positions, are enough.

    Each stage has its folder in the project's work folder and is kept while neither its inputs nor the code
    that it runs change. Your own files in these folders are kept and listed. The project file is described in
    docs/project-file.md.

    Example: `photocal run PROJECT.toml`
    """
    import datetime as dt

    from photocal.findings.texts import catalogue, spoken

    say = catalogue(spoken(language))
    bar = one_bar(as_json, progress_words(say))
    with while_starting(bar):
        from photocal.base.tables import leave_pandas
        from photocal.base.workers import Cluster

        leave_pandas()
        from photocal.run.campaign import Said, run_projects, say_line
        from photocal.run.summary import certificate_line, summary_text

    day = dt.datetime.now().astimezone().date()
    judged = list[str]()

    def tell(said: Said) -> None:
        """Say a verdict to a person, who need not wait for the certificate, and lines on the way."""
        if as_json or isinstance(said, str):
            say_line(said)
            return
        judged.append(said["work"])
        answer(False, lambda: said, lambda: summary_text(said, say, details=details))

    crew = workers if cluster is None else Cluster(cluster)
    figures = run_projects(projects, day, until, again, rehash, crew, bar, tell)
    answer(
        as_json,
        lambda: figures[0] if len(projects) == 1 else figures,
        lambda: "\n\n".join(
            certificate_line(figure, say)
            if figure["work"] in judged
            else summary_text(figure, say, details=details)
            for figure in figures
        ),
    )


def progress_words(say: "Catalogue") -> dict[str, str]:
    """Titles of the work of a run, which the window has, and its time left, in the language of a person."""
    if say.language == "en":
        return {}
    window = json.loads(resources.files("photocal.desk").joinpath("page", "texts.json").read_text("utf-8"))
    titles = dict(pair for key, pair in window.items() if key.startswith("work."))
    return {**titles, OF_RUN: say.messages["ran.of_run"], ON_BAR: say.messages["ran.on_bar"]}


def debrief(
    project: Annotated[
        Path, argument("Project file, or the folder that has `project.toml`.", metavar="PROJECT")
    ],
    since: Annotated[
        Path | None, option("Run folder or file of cameras of the last calibration, to compare c with.")
    ] = None,
    workers: Annotated[int, option("Number of processes; 0: one for each core.", min=0)] = 0,
    language: Language = "",
    live: Annotated[
        bool,
        option("Run during the flight: judge pictures as they arrive in the folder, until Ctrl-C.", "--live"),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Judge a flight before the crew drives home: complete, to be checked, or to be flown again.

    Exposures without pictures, blurred and badly exposed pictures, another camera or lens setting, positions
    that are not fixed, strips with too little overlap, ground that is not covered, and a quick calibration on
    reduced pictures. Run it again while pictures come in: finished checks are kept. The answer is also
    written as debrief.json into the project's work folder: `acquire monitor --page --debrief` shows it.

    With --live it watches the folder that a tethered camera or a picture link writes to. It then uses the
    positions stated in the pictures and does not read the flight log. When c is as well determined as
    `[calibration]` of the project wants, it says that you may land; after Ctrl-C it judges all pictures
    together once more. Without --workers it examines one picture at a time.

    Example: `photocal debrief project.toml --since last/calibration`
    """
    import os

    from photocal.block.project import read_project
    from photocal.findings.texts import catalogue, finding_text, spoken
    from photocal.run.debrief.verdict import calibration_text, debrief_json, debrief_text
    from photocal.run.debrief.verdict import debrief as judged

    file = project / "project.toml" if project.is_dir() else project
    say, last = catalogue(spoken(language)), () if since is None else _cameras(since)
    known = read_project(file)
    if live:
        from photocal.base.operating_system import stopped_by_signals
        from photocal.run.debrief.live import follow

        def report(so_far: "Debrief") -> None:
            """Say the verdict so far, while the flight is still being read."""
            for line in (finding_text(so_far.verdict, say), *calibration_text(so_far, say)):
                typer.echo(printable(line), err=True)

        # One examines pictures faster than they come; each takes memory.
        made = follow(known, workers or 1, stopped_by_signals(), report, last)
    else:
        made = judged(known, workers or os.cpu_count() or 1, progress, last)
    answer(as_json, lambda: debrief_json(made), lambda: debrief_text(made, say))


def _cameras(since: Path) -> "tuple[Camera, ...]":
    """Cameras of a run folder or of a file of cameras."""
    from photocal.analysis.stability.camera_file import read_camera_file
    from photocal.block.results.folder import read_result

    if since.is_dir():
        return tuple(read_result(since).cameras.values())
    return read_camera_file(since).calibrations


def desk(
    folder: Annotated[
        Path, argument("Folder of a flight, or a folder that has such folders.", metavar="FOLDER")
    ],
    address: Address = "127.0.0.1:8760",
    cache: Annotated[Path | None, option("Folder for tiles; ~/.cache/photocal when not given.")] = None,
    language: Language = "",
    as_json: Annotated[
        bool, option("Print the state of the steps as JSON, and open no window.", "--json")
    ] = False,
) -> None:
    """Open a window on a folder: choose, check, run, look, certify, on a local web page.

    The page runs commands and shows each of them.

    Example: `photocal desk flight`
    """
    from photocal.base.operating_system import cache_folder, stopped_by_signals, wait_until
    from photocal.base.web import read_address, serving
    from photocal.desk.session import Desk
    from photocal.desk.standing import application, shown
    from photocal.findings.texts import catalogue, spoken

    tiles = cache or cache_folder()
    if as_json:
        answer(True, lambda: shown(Desk(folder, tiles)), str)
        return
    stop = stopped_by_signals()
    page = application(folder, tiles)
    with serving(page, read_address(address)) as url:
        typer.echo(catalogue(spoken(language))("marked.open_desk", url=url))
        wait_until(stop)
