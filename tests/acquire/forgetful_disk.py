"""A disk of its own under a real file system: it forgets at a power cut what was not flushed, and has faults.

The kernel's file system (ext4, ext2) lies on a loop device; its file is served by this process over FUSE
(linux/fuse.h, version 7.31), so each write and each flush of the device passes here. It needs root and
`/dev/fuse`; `forbidden` tells what is missing.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import random
import shutil
import struct
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

SECTOR = 512
_NAME, _ROOT, _FILE = b"disk", 1, 2
_IN = struct.Struct("<IIQQIIIHH")
_OUT = struct.Struct("<IiQ")
_LOOKUP, _FORGET, _GETATTR, _SETATTR, _OPEN, _READ, _WRITE = 1, 2, 3, 4, 14, 15, 16
_STATFS, _RELEASE, _FSYNC, _FLUSH, _INIT, _INTERRUPT, _DESTROY, _BATCH_FORGET = 17, 18, 20, 25, 26, 36, 38, 42
_LONGEST = 1 << 20
_MB = 1 << 20


def forbidden() -> str:
    """Say what this machine lacks for such a disk; empty when nothing."""
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        return "only root may mount"
    missing = [name for name in ("losetup", "mkfs.ext4", "mount", "umount") if shutil.which(name) is None]
    if missing:
        return f"{', '.join(missing)} is not installed"
    try:
        with disk_mounted(8):
            return ""
    except (OSError, subprocess.CalledProcessError) as refusal:
        return f"no FUSE, loop device or mount here ({refusal})"


@dataclass
class Faults:
    """What is wrong with a disk now.

    writes, flushes: errno of each write and flush; 0: they succeed.
    bytes_s: how many bytes a second it takes; 0: at once.
    stall_every_s, stall_s: it does nothing for so long, so often; 0: never.
    """

    writes: int = 0
    flushes: int = 0
    bytes_s: float = 0.0
    stall_every_s: float = 0.0
    stall_s: float = 0.0


@dataclass
class ForgetfulDisk:
    """The disk: what was flushed, and what would be lost now."""

    size: int
    faults: Faults = field(default_factory=Faults)
    written: int = 0
    flushed: int = 0

    def __post_init__(self) -> None:
        self._durable, self._content = bytearray(self.size), bytearray(self.size)
        self._pending: list[tuple[int, bytes]] = []
        self._lock = threading.Lock()
        self._stalled_s = time.monotonic()

    def cut(self, chance: random.Random) -> bytes:
        """Return what a power cut now leaves: all that was flushed, and any part of what was not."""
        with self._lock:
            left, pending = bytearray(self._durable), list(self._pending)
        share = chance.choice((0.0, 1.0, chance.random()))
        for offset, data in pending:
            if chance.random() >= share:
                continue
            # A write may be torn between two sectors.
            sectors = len(data) // SECTOR
            first, last = 0, sectors
            if chance.random() < 0.2:
                first, last = sorted(chance.choices(range(sectors + 1), k=2))
            left[offset + first * SECTOR : offset + last * SECTOR] = data[first * SECTOR : last * SECTOR]
        return bytes(left)

    def content(self) -> bytes:
        """Return all that was written."""
        with self._lock:
            return bytes(self._content)

    def read(self, offset: int, size: int) -> bytes:
        """Give what was written."""
        with self._lock:
            return bytes(self._content[offset : offset + size])

    def write(self, offset: int, data: bytes) -> int:
        """Take what is written; return an errno."""
        if self.faults.writes:
            return self.faults.writes
        self._take_time(len(data))
        with self._lock:
            self._content[offset : offset + len(data)] = data
            self._pending.append((offset, data))
            self.written += len(data)
        return 0

    def flush(self) -> int:
        """Make safe what was written; return an errno."""
        if self.faults.flushes:
            return self.faults.flushes
        self._take_time(0)
        with self._lock:
            for offset, data in self._pending:
                self._durable[offset : offset + len(data)] = data
            self._pending.clear()
            self.flushed += 1
        return 0

    def _take_time(self, size: int) -> None:
        faults = self.faults
        if faults.stall_s and time.monotonic() - self._stalled_s > faults.stall_every_s:
            time.sleep(faults.stall_s)
            self._stalled_s = time.monotonic()
        if faults.bytes_s:
            time.sleep(size / faults.bytes_s)


def _serve(line: int, disk: ForgetfulDisk) -> None:
    """Answer the kernel until the disk is taken away."""
    while True:
        try:
            request = os.read(line, _LONGEST + 4096)
        except OSError as end:
            if end.errno in (errno.EINTR, errno.EAGAIN, errno.ENOENT):
                continue
            return
        _, opcode, unique, node, *_ = _IN.unpack_from(request)
        if opcode in (_FORGET, _BATCH_FORGET, _INTERRUPT):
            continue
        code, answer = _answered(disk, opcode, node, memoryview(request)[_IN.size :])
        with contextlib.suppress(OSError):
            os.write(line, _OUT.pack(_OUT.size + len(answer), -code, unique) + answer)
        if opcode == _DESTROY:
            return


def _answered(disk: ForgetfulDisk, opcode: int, node: int, body: memoryview) -> tuple[int, bytes]:
    """Return errno and answer of a request."""
    if opcode == _INIT:
        return 0, struct.pack("<IIIIHHIIHHI28x", 7, 31, _LONGEST, 0, 12, 9, _LONGEST, 1, 0, 0, 0)
    if opcode == _LOOKUP:
        if bytes(body).rstrip(b"\0") != _NAME:
            return errno.ENOENT, b""
        return 0, struct.pack("<QQQQII", _FILE, 0, 3600, 3600, 0, 0) + _attributes(disk, _FILE)
    if opcode in (_GETATTR, _SETATTR):
        return 0, struct.pack("<QII", 3600, 0, 0) + _attributes(disk, node)
    if opcode == _OPEN:
        return 0, struct.pack("<QII", 0, 0, 0)
    if opcode == _READ:
        _, offset, size = struct.unpack_from("<QQI", body)
        return 0, disk.read(offset, size)
    if opcode == _WRITE:
        _, offset, size = struct.unpack_from("<QQI", body)
        return disk.write(offset, bytes(body[40 : 40 + size])), struct.pack("<II", size, 0)
    if opcode == _FSYNC:
        return disk.flush(), b""
    if opcode == _STATFS:
        return 0, struct.pack("<QQQQQIII24x", disk.size // 4096, 0, 0, 2, 0, 4096, 255, 4096) + bytes(4)
    return (0, b"") if opcode in (_RELEASE, _FLUSH, _DESTROY) else (errno.ENOSYS, b"")


def _attributes(disk: ForgetfulDisk, node: int) -> bytes:
    mode, size = (0o100600, disk.size) if node == _FILE else (0o40700, 0)
    return struct.pack("<QQQ36xIIIIIII", node, size, size // SECTOR, mode, 1, 0, 0, 0, 4096, 0)


def _run(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def _unmount(folder: str) -> None:
    """Take a file system away; one that is still in use goes when it is not any more."""
    for command in (["umount", folder], ["umount", "-l", folder]):
        if not subprocess.run(command, check=False, capture_output=True).returncode:
            return


@contextlib.contextmanager
def served(disk: ForgetfulDisk) -> Iterator[Path]:
    """Give the file of a disk."""
    library = ctypes.CDLL(None, use_errno=True)
    with tempfile.TemporaryDirectory() as name:
        line = os.open("/dev/fuse", os.O_RDWR)
        try:
            options = f"fd={line},rootmode=40000,user_id=0,group_id=0".encode()
            if library.mount(b"forgetful", name.encode(), b"fuse.forgetful", 0, options):
                code = ctypes.get_errno()
                raise OSError(code, os.strerror(code))
            server = threading.Thread(target=_serve, args=(line, disk), daemon=True)
            server.start()
            try:
                yield Path(name) / os.fsdecode(_NAME)
            finally:
                _unmount(name)
                server.join(5)
        finally:
            os.close(line)


@contextlib.contextmanager
def disk_mounted(size_mb: int, kind: str = "ext4", options: str = "") -> Iterator[tuple[Path, ForgetfulDisk]]:
    """Give the folder of a new file system on a forgetful disk, and the disk."""
    disk = ForgetfulDisk(size_mb * _MB)
    with served(disk) as file, tempfile.TemporaryDirectory() as name:
        device = _run("losetup", "--find", "--show", str(file))
        try:
            settled = "nodiscard,lazy_itable_init=0,lazy_journal_init=0"
            _run(f"mkfs.{kind}", "-q", "-E", settled, "-m", "0", device)
            _run("mount", "-t", kind, *(("-o", options) if options else ()), device, name)
            try:
                yield Path(name), disk
            finally:
                disk.faults = Faults()
                _unmount(name)
        finally:
            subprocess.run(["losetup", "--detach", device], check=False, capture_output=True)


@contextlib.contextmanager
def after_the_cut(image: bytes, kind: str = "ext4") -> Iterator[Path]:
    """Give the folder of a disk as it is found when the power is back, repaired as by a starting system."""
    with tempfile.TemporaryDirectory(dir="/dev/shm") as name:
        file, folder = Path(name) / "disk", Path(name) / "found"
        file.write_bytes(image)
        folder.mkdir()
        if kind == "ext2":
            subprocess.run(["e2fsck", "-fy", str(file)], check=False, capture_output=True)
        _run("mount", "-t", kind, "-o", "loop", str(file), str(folder))
        try:
            yield folder
        finally:
            _run("umount", str(folder))
