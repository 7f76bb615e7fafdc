"""MAVLink messages against pymavlink as encoder and decoder."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as peer

from drivers.frames import Batch, StreamFramer, Wire
from drivers.mavlink.decode import decode, encode, sequences, sources
from drivers.mavlink.dialect import ardupilotmega

DIALECT = ardupilotmega()


def framed(data: bytes) -> Batch:
    framer = StreamFramer((Wire.MAVLINK,))
    first, last = framer.feed(data), framer.close()
    assert not len(last)
    return first


def same(ours: Any, theirs: Any) -> bool:
    if isinstance(theirs, str):
        return bytes(ours).split(b"\0")[0] == theirs.encode("utf-8", "surrogateescape").split(b"\0")[0]
    if isinstance(theirs, (list, tuple)):
        return all(same(a, b) for a, b in zip(ours, theirs, strict=True))
    if isinstance(theirs, float) and math.isnan(theirs):
        return bool(np.isnan(ours))
    return bool(ours == theirs)


@settings(max_examples=400)
@given(st.sampled_from(sorted(peer.mavlink_map)), st.binary(min_size=255, max_size=255), st.booleans())
def test_every_message_decodes_as_by_pymavlink(message: int, noise: bytes, truncated: bool) -> None:
    known = peer.mavlink_map[message]
    size = known.unpacker.size
    payload = bytearray(noise[:size])
    for name, kind in zip(known.ordered_fieldnames, range(len(known.ordered_fieldnames)), strict=True):
        # Texts: pymavlink wants them decodable.
        if known.fieldtypes[known.fieldnames.index(name)] == "char":
            at = DIALECT.layout(message).fields[name][1]  # type: ignore[index]
            width = DIALECT.layout(message).fields[name][0].itemsize  # type: ignore[index]
            payload[at : at + width] = b"x" * width
        assert kind >= 0
    if truncated:
        payload[size // 2 :] = bytes(size - size // 2)
    sender = peer.MAVLink(None, srcSystem=7, srcComponent=9)
    sender.seq = 200
    values = known.unpacker.unpack(bytes(payload))
    theirs = peer.MAVLink(None)
    theirs.robust_parsing = True
    frame = _pack(sender, message, bytes(payload))
    (parsed,) = theirs.parse_buffer(frame)
    batch = framed(frame)
    assert batch.kind.tolist() == [message]
    assert batch.known.all()
    ours = decode(batch, message, DIALECT)
    system, component = sources(batch, ours.index)
    assert (system[0], component[0], sequences(batch, ours.index)[0]) == (7, 9, 200)
    assert len(values) > 0
    for name in known.fieldnames:
        assert same(ours.fields[name][0], getattr(parsed, name)), name


def _pack(sender: Any, message: int, payload: bytes) -> bytes:
    known = peer.mavlink_map[message]
    header = peer.MAVLink_message(message, known.msgname)
    return bytes(header._pack(sender, known.crc_extra, payload))


def test_version_1_frames_and_signed_frames_are_recognised() -> None:
    first = peer.MAVLink(None, srcSystem=1, srcComponent=1)
    old = first.heartbeat_encode(2, 3, 81, 0, 4).pack(first, force_mavlink1=True)
    signing = peer.MAVLink(None, srcSystem=1, srcComponent=1)
    signing.signing.secret_key = b"k" * 32
    signing.signing.sign_outgoing = True
    signing.signing.timestamp = 1
    signed = signing.attitude_encode(1000, 0.1, -0.2, 0.3, 0, 0, 0).pack(signing)
    batch = framed(bytes(old) + bytes(signed) + bytes(old))
    assert batch.kind.tolist() == [0, 30, 0]
    assert batch.length.tolist() == [len(old), len(signed), len(old)]
    assert not len(batch.damage)
    angles = decode(batch, 30, DIALECT).fields
    assert angles["pitch"][0] == pytest.approx(-0.2)


def test_unknown_messages_of_another_dialect_are_kept() -> None:
    known = encode(DIALECT, 0, {"type": 2}, sequence=1, system=1, component=1)
    body = bytes([3, 0, 0, 2, 1, 1]) + (60_123).to_bytes(3, "little") + b"abc"
    check = peer.x25crc(body + bytes([77])).crc
    private = b"\xfd" + body + check.to_bytes(2, "little")
    batch = framed(known + private + known)
    assert batch.kind.tolist() == [0, 60_123, 0]
    assert batch.known.tolist() == [True, False, True]


def test_frames_with_flags_that_nobody_knows_are_damage() -> None:
    known = encode(DIALECT, 0, {"type": 2}, sequence=1, system=1, component=1)
    strange = known[:2] + b"\x02" + known[3:]
    batch = framed(strange + known)
    assert len(batch) == 1
    assert batch.damage.tolist() == [[0, len(strange)]]


@settings(max_examples=100)
@given(st.floats(-3, 3, width=32), st.integers(0, 2**32 - 1), st.integers(0, 255))
def test_our_frames_are_read_by_pymavlink(angle: float, boot: int, sequence: int) -> None:
    frame = encode(
        DIALECT, 30, {"roll": angle, "time_boot_ms": boot}, sequence=sequence, system=4, component=5
    )
    reader = peer.MAVLink(None)
    (message,) = reader.parse_buffer(frame)
    assert message.get_type() == "ATTITUDE"
    assert (message.roll, message.time_boot_ms, message.get_seq()) == (angle, boot, sequence)


def test_a_field_that_a_message_does_not_have_is_refused() -> None:
    with pytest.raises(KeyError):
        encode(DIALECT, 30, {"rol": 1}, sequence=0, system=1, component=1)
