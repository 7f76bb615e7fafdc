"""Import of recordings: bytes to frames to the flight log, link after link."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquire.channels.link import LinkLog, Tally
from acquire.importing.recording import RecordedBytes, RecordingFormat, identify, open_recording
from acquire.importing.timing import way_of
from acquire.log.writer import LogWriter
from drivers.mavlink.dialect import Dialect, ardupilotmega
from photocal.base.errors import ConfigurationError
from photocal.base.files import output_file
from photocal.base.version import __version__

CHUNK_BYTES = 1 << 20
_COUNTED = ("frames", "frame_bytes", "stamp_bytes", "damage_bytes", "damage_runs")


@dataclass(frozen=True)
class Imported:
    """What was imported over one link.

    sha256, size: of the file as it lies on disk.
    log_time: where the times of receipt come from.
    cut: bytes of a frame that the end of the recording cut off.
    packing_cut: whether the file is packed and its end is missing.
    warning: what to know about the times; empty when they are sure.
    """

    link: str
    path: Path
    sha256: str
    size: int
    form: RecordingFormat
    log_time: str
    tally: Tally
    cut: int
    packing_cut: bool
    warning: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return the figures for programs."""
        return {
            "link": self.link,
            "file": str(self.path),
            "sha256": self.sha256,
            "bytes": self.size,
            "format": self.form.name,
            "log_time": self.log_time,
            **{key: getattr(self.tally, key) for key in _COUNTED},
            "cut_bytes": self.cut,
            "packing_cut": self.packing_cut,
            "warning": self.warning,
        }

    def metadata(self) -> dict[str, str]:
        """Return the table that the log keeps."""
        runs = self.tally.damage
        listed = " ".join(f"{offset}+{length}" for offset, length in runs)
        figures = {key: str(value) for key, value in self.as_json().items()}
        # The name is enough: the folder says something about a machine, not about the flight.
        figures["file"] = self.path.name
        figures["damage_at"] = listed + (" ..." if self.tally.damage_runs > len(runs) else "")
        return figures


def import_recordings(
    named: Sequence[tuple[str, Path]],
    unnamed: Sequence[Path],
    output: Path,
    advance: Callable[[float], None],
    near_ns: int = -1,
) -> list[Imported]:
    """Import recordings into one flight log.

    near_ns: UTC within half a day of the beginning of streams that do not tell their date, nanoseconds since
        1970.
    raises InputNotFoundError, InputMalformedError, ConfigurationError, OutputError: see the messages.
    """
    dialect = ardupilotmega()
    results: list[Imported] = []
    links: set[str] = set()
    with output_file(output) as aside, aside.open("wb") as stream:
        writer = LogWriter(stream)
        writer.metadata("software", {"name": "photocal acquire", "version": __version__})
        for name, path in [*named, *(("", path) for path in unnamed)]:
            with open_recording(path) as source:
                form = identify(source, dialect)
                plain = re.sub(r"[^A-Za-z0-9_-]+", "-", path.name.split(".")[0]).strip("-")
                link = name or form.link or plain or "receiver"
                if link in links:
                    raise ConfigurationError(
                        f"two recordings would become the link {link!r}",
                        "name each with --link NAME=FILE",
                        where=path,
                    )
                links.add(link)
                results.append(_import(writer, link, source, form, dialect, advance, near_ns))
        writer.close()
    return results


def _import(
    writer: LogWriter,
    link: str,
    source: RecordedBytes,
    form: RecordingFormat,
    dialect: Dialect,
    advance: Callable[[float], None],
    near_ns: int,
) -> Imported:
    framer = form.framer(dialect)
    way = way_of(source, form, link, dialect, near_ns)
    log = LinkLog(writer, link, [way.decoder])

    for batch, log_ns in way.timed(source.batches(framer, advance)):
        log.write(batch, log_ns)
        if writer.open_bytes > CHUNK_BYTES:
            writer.end_chunk()
    imported = Imported(
        link=link,
        path=source.path,
        sha256=source.sha256(),
        size=source.size(),
        form=form,
        log_time=way.time_source(),
        tally=log.tally,
        cut=framer.cut,
        packing_cut=source.cut,
        warning=way.warned(log.last_ns),
    )
    writer.metadata(f"import {link}", imported.metadata())
    return imported
