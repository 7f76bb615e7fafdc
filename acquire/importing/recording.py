"""A recording of another program: what it is, told by its content, and its bytes."""

import gzip
import hashlib
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path

from drivers.dataflash import DataflashFramer
from drivers.frames import Batch, Framer, StreamFramer
from drivers.mavlink.dialect import Dialect
from drivers.mrk import MrkFramer
from drivers.protocols import receiver_protocols, receiver_wires
from drivers.tlog import TlogFramer
from drivers.ulog import UlogFramer
from photocal.base.errors import InputMalformedError, InputNotFoundError, reading

PIECE_BYTES = 1 << 20
_HEAD_BYTES = 1 << 17
_GZIP = b"\x1f\x8b"


@dataclass(frozen=True)
class RecordingFormat:
    """A kind of recording.

    link: what a link with it is called when nobody names it; empty: after the file.
    framer: takes the known MAVLink messages and returns what finds the frames.
    """

    name: str
    link: str
    framer: Callable[[Dialect], Framer]


TELEMETRY_LOG = RecordingFormat("MAVLink telemetry log", "vehicle", TlogFramer)
RECEIVER_STREAM = RecordingFormat(
    "GNSS receiver stream", "", lambda dialect: StreamFramer(receiver_wires(), dialect)
)
DATAFLASH_LOG = RecordingFormat("ArduPilot DataFlash log", "vehicle", lambda _: DataflashFramer())
PX4_LOG = RecordingFormat("PX4 log (ULog)", "vehicle", lambda _: UlogFramer())
EVENT_LIST = RecordingFormat("event list (Timestamp.MRK)", "camera", lambda _: MrkFramer())
FORMATS = (TELEMETRY_LOG, RECEIVER_STREAM, DATAFLASH_LOG, PX4_LOG, EVENT_LIST)


class RecordedBytes:
    """The bytes of a recording, unpacked, with the hash and the size of the file that they come from."""

    def __init__(self, path: Path, raw: BufferedReader) -> None:
        self.path = path
        self.packed = raw.read(2) == _GZIP
        raw.seek(0)
        self._raw = raw
        self.cut = False

    def pieces(self) -> Iterator[bytes]:
        """Yield the bytes from the beginning; a packed file that ends early sets `cut`.

        raises InputMalformedError: when a packed file is damaged inside.
        """
        self._raw.seek(0)
        if not self.packed:
            while piece := self._raw.read(PIECE_BYTES):
                yield piece
            return
        with gzip.GzipFile(fileobj=self._raw) as unpacked:
            while True:
                try:
                    # read1 gives what could still be unpacked before the cut.
                    piece = unpacked.read1(PIECE_BYTES)
                except EOFError:
                    self.cut = True
                    return
                except (OSError, zlib.error) as damage:
                    raise InputMalformedError(
                        f"the gzip packing is damaged ({damage})", "take another copy", where=self.path
                    ) from damage
                if not piece:
                    return
                yield piece

    def batches(self, framer: Framer, advance: Callable[[float], None] = lambda _: None) -> Iterator[Batch]:
        """Yield the frames; `advance` is told how much more of the file was read, bytes."""
        done = 0
        for piece in self.pieces():
            yield framer.feed(piece)
            advance(self._raw.tell() - done)
            done = self._raw.tell()
        yield framer.close()

    def size(self) -> int:
        """Return the size of the file, bytes."""
        return self.path.stat().st_size

    def sha256(self) -> str:
        """Return the SHA-256 of the file as it lies on disk."""
        self._raw.seek(0)
        return hashlib.file_digest(self._raw, "sha256").hexdigest()


@contextmanager
def open_recording(path: Path) -> Iterator[RecordedBytes]:
    """Open a recording."""
    if path.is_dir():
        raise InputNotFoundError("is a folder, a recording was expected", "name the file", where=path)
    with reading(path):
        raw = path.open("rb")
    with raw:
        if not raw.read(1):
            raise InputNotFoundError("is empty", "name a recording that has data", where=path)
        raw.seek(0)
        yield RecordedBytes(path, raw)


def identify(source: RecordedBytes, dialect: Dialect) -> RecordingFormat:
    """Tell the format of a recording by what its first part holds."""
    head = bytearray()
    for piece in source.pieces():
        head += piece
        if len(head) >= _HEAD_BYTES:
            break
    del head[_HEAD_BYTES:]
    best, most = None, 0
    for form in FORMATS:
        framer = form.framer(dialect)
        batches = [framer.feed(bytes(head))]
        if len(head) < _HEAD_BYTES:
            batches.append(framer.close())
        held = sum(int(batch.length.sum()) for batch in batches)
        if held > most:
            best, most = form, held
        if 2 * held > len(head):
            break
    if best is None:
        *names, last = (protocol.name for protocol in receiver_protocols())
        raise InputMalformedError(
            f"has no complete MAVLink record, no {', '.join(names)} or {last} frame, no DataFlash, ULog or "
            "MRK record",
            "import a .tlog, .ubx, .rtcm3, .nmea, .bin, .ulg or .mrk recording",
            where=source.path,
        )
    return best
