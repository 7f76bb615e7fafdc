"""Study: does the debrief in flight keep up with a camera while `acquire record` records beside it?

Writes `docs/evidence/live.md`. Pictures of a folder come one every two seconds into the folder of a project,
`photocal debrief --live` follows it, and a recorder of its own takes numbered frames on four links.
Every frame is looked for in the log; the lag of a picture runs from its coming to rest to its verdict.
Processor and memory are those of the debrief with all processes that it begins, to its last verdict.

Run: `python -m tests.evidence.live FOLDER...`, each with the pictures of a flight in their order.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from photocal.measurement.image_facts import read_facts
from photocal.measurement.image_file import list_images
from tests.acquire.live import Recorder, frames_in, free_port, is_bound, until
from tests.evidence.flood import send_numbered
from tests.processes import memory_mib

EVERY_S, MOST = 2.0, 60
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "live.md"
PROJECT = """[project]
name = "live"
crs = "local"
height = "local"
output = "work"

[images]
folder = "images"
"""


def main() -> None:
    """Run the study and write its page."""
    if len(sys.argv) < 2:
        sys.stderr.write("live: not run, it needs a folder of pictures\n")
        return
    columns = []
    for folder in sys.argv[1:]:
        sent = list_images(Path(folder))[:MOST]
        width, height = read_facts(sent[0]).size_px
        with tempfile.TemporaryDirectory() as name:
            figures = study(sent, Path(name))
        columns.append({"pictures": f"{len(sent)} of {width} x {height} px", **figures})
    lines = [
        "# The debrief in flight during a recording",
        "",
        f"Pictures arrived one every {EVERY_S:g} s in a folder that `photocal debrief --live` followed, on",
        "two cores. At the same time `acquire record` took 100 frames of 196 bytes a second on each of",
        "four links. Lag of a picture: from the moment its file stops growing to its verdict. Processor",
        "and memory: of the debrief and all that it starts, from its start to its last verdict.",
        "",
        "|" + " |" * (len(columns) + 1),
        "|" + "---|" * (len(columns) + 1),
        *("| " + " | ".join([what, *(column[what] for column in columns)]) + " |" for what in columns[0]),
        "",
        "Made by `python -m tests.evidence.live`.",
        "",
    ]
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")
    sys.stderr.write("\n".join(lines))


def study(sent: Sequence[Path], folder: Path) -> dict[str, str]:
    """Feed the pictures, record, and give the figures."""
    (folder / "images").mkdir()
    (folder / "project.toml").write_text(PROJECT)
    ports = [free_port() for _ in range(4)]
    (folder / "flight.toml").write_text(
        '[recording]\noutput = "logs"\nleast_free_mb = 0\n'
        + "".join(
            f'[[link]]\nname = "l{n}"\nprotocol = "ubx"\nurl = "udp://127.0.0.1:{port}"\nsilent_s = 600\n'
            for n, port in enumerate(ports)
        )
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
    command = [sys.executable, "-m", "photocal", "debrief", str(folder), "--live", "--json"]
    file, lags, waiting, memory = folder / "work" / "debrief.json", [], [], []
    frames: list[tuple[float, bytes]] = []
    with ExitStack() as running:
        recorder = running.enter_context(Recorder(folder / "flight.toml"))
        until(lambda: all(map(is_bound, ports)), "the ports")
        live = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)
        running.callback(live.kill)
        until(file.exists, "the first verdict")
        ended = threading.Event()

        def speak() -> None:
            while not ended.is_set():
                frames.extend(send_numbered(ports, 1.0, len(frames)))

        speaker = threading.Thread(target=speak)
        speaker.start()

        def seen() -> dict[str, Any]:
            content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
            lags.append(float(content["live"]["lag_s"]))
            memory.append(sum(memory_mib(live.pid, "VmRSS")))
            waiting.append(int(content["live"]["waiting"]))
            return content

        begun = time.monotonic()
        for k, path in enumerate(sent):
            shutil.copyfile(path, folder / "images" / path.name)
            while time.monotonic() < begun + EVERY_S * (k + 1):
                time.sleep(0.25)
                seen()
        last = time.monotonic()
        until(lambda: len(seen()["pictures"]) == len(sent), "the last picture")
        behind_s = time.monotonic() - last
        until(lambda: seen()["quick"], "an orientation")
        joined = seen()["quick"]["joined"]
        stopped = time.monotonic()
        live.send_signal(signal.SIGINT)
        _, status, usage = os.wait4(live.pid, 0)
        stop_s = time.monotonic() - stopped
        assert status == 0
        ended.set()
        speaker.join()
        content = json.loads(file.read_text(encoding="utf-8"))
        recorder.figures()
        kept = [set(frames_in(recorder.path, f"l{n}")) for n in range(4)]
    lost = sum(frame not in found for _, frame in frames for found in kept)
    (camera,) = content["determined"]
    return {
        "frames sent": f"{4 * len(frames)}",
        "frames lost": f"{lost}",
        "lag, median": f"{np.median(lags):.1f} s",
        "lag, worst": f"{max(lags):.1f} s",
        "most pictures waiting": f"{max(waiting)}",
        "the last picture, after it was sent": f"{behind_s:.1f} s",
        "pictures oriented by then": f"{joined}",
        "from Ctrl-C to the last verdict": f"{stop_s:.1f} s",
        "pictures oriented in it": f"{content['quick']['joined']}",
        "c": f"{camera['c']:.1f} ± {camera['sigma']:.1f} px, wanted ± {camera['wanted']:.1f} px",
        "processor": f"{(usage.ru_utime + usage.ru_stime) / len(sent):.2f} s a picture",
        "peak memory": f"{max(usage.ru_maxrss / 1024, *memory):.0f} MiB",
        "load of the machine (1 min)": f"{os.getloadavg()[0]:.1f}",
    }


if __name__ == "__main__":
    main()
