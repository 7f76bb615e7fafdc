"""A slow, plain scanner with other people's checksums: what the framers are measured against."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from pynmeagps import calc_checksum as nmea_checksum
from pyrtcm import calc_crc24q
from pyubx2 import calc_checksum as ubx_checksum

# protocol, offset, length
Found = tuple[str, int, int]
Scanner = Callable[[bytes], list[Found]]


def _ubx(data: bytes, at: int) -> int:
    if data[at : at + 2] != b"\xb5\x62" or at + 8 > len(data):
        return 0
    length = int.from_bytes(data[at + 4 : at + 6], "little") + 8
    frame = data[at : at + length]
    whole = length <= 8200 and len(frame) == length
    return length if whole and ubx_checksum(frame[2:-2]) == frame[-2:] else 0


def _rtcm3(data: bytes, at: int) -> int:
    if data[at] != 0xD3 or at + 6 > len(data) or data[at + 1] > 3:
        return 0
    length = int.from_bytes(data[at + 1 : at + 3], "big") + 6
    frame = data[at : at + length]
    return length if len(frame) == length and calc_crc24q(frame) == 0 else 0


def _nmea(data: bytes, at: int) -> int:
    if data[at] != 0x24:
        return 0
    end = data.find(b"\r\n", at, at + 1024)
    sentence = data[at:end] if end > 0 else b""
    body, star, check = sentence[1:].partition(b"*")
    address = body.split(b",")[0]
    printable = all(0x20 <= c < 0x7F and c not in b"$*" for c in body)
    if not star or len(check) != 2 or not printable or not 2 <= len(address) <= 8:
        return 0
    if not (address.isalnum() and address.isupper() and address[:1].isalpha()):
        return 0
    return end + 2 - at if nmea_checksum(body.decode()).encode() == check.upper() else 0


@pytest.fixture(scope="session")
def scan() -> Scanner:
    """Scanner of a mixed stream of UBX, RTCM3 and NMEA."""

    def scanner(data: bytes) -> list[Found]:
        found, at = [], 0
        while at < len(data):
            for name, test in (("UBX", _ubx), ("RTCM3", _rtcm3), ("NMEA", _nmea)):
                if length := test(data, at):
                    found.append((name, at, length))
                    at += length
                    break
            else:
                at += 1
        return found

    return scanner
