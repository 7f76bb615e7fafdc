from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.generator.mavcrc import x25crc
from pyrtcm import calc_crc24q
from pyubx2 import calc_checksum

from drivers.checksums import crc24q, fletcher8, x25


@given(st.binary(max_size=300), st.integers(0, 255))
def test_x25_agrees_with_pymavlink(data: bytes, seed: int) -> None:
    peer = x25crc(data)
    assert x25(data) == peer.crc
    peer.accumulate(bytes([seed]))
    assert x25(data, seed) == peer.crc


@given(st.binary(max_size=600))
def test_fletcher_agrees_with_pyubx2(data: bytes) -> None:
    assert fletcher8(data) == calc_checksum(data)


@given(st.binary(max_size=1026))
def test_crc24q_agrees_with_pyrtcm(data: bytes) -> None:
    assert crc24q(data) == calc_crc24q(data)
