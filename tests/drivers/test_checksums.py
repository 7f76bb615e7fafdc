from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.generator.mavcrc import x25crc
from pyrtcm import calc_crc24q
from pyubx2 import calc_checksum

from drivers.checksums import crc24q, fletcher8, x25
from drivers.window import Window


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


@given(st.binary(min_size=1, max_size=400), st.data())
def test_running_sums_give_the_checksum_of_every_part(data: bytes, draw: st.DataObject) -> None:
    begin = draw.draw(st.integers(0, len(data)))
    end = draw.draw(st.integers(begin, len(data)))
    window = Window(data, closed=True)
    assert bytes(window.fletcher8(begin, end)) == calc_checksum(data[begin:end])
    expected = 0
    for value in data[begin:end]:
        expected ^= value
    assert window.xor8(begin, end) == expected
