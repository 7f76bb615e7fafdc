"""The simulated devices, spoken to by pymavlink and pyubx2 over real ports."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from typing import Any

import pytest
import serial
from pymavlink.dialects.v20 import ardupilotmega as tables
from pyubx2 import POLL, SET, UBXMessage, UBXReader

from acquire.simulate.hardware import on_pty, on_udp
from tests.acquire.devices import Autopilot, Receiver
from tests.acquire.live import PATIENCE_S


def collect(peer: socket.socket, kinds: set[str], mav: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    end = time.monotonic() + PATIENCE_S
    while not kinds <= set(found) and time.monotonic() < end:
        for message in mav.parse_buffer(peer.recv(2000)) or []:
            found[message.get_type()] = message
    return found


def test_the_autopilot_answers_over_udp(udp_peer: socket.socket) -> None:
    peer = udp_peer
    peer.bind(("127.0.0.1", 0))
    peer.settimeout(PATIENCE_S)
    mav = tables.MAVLink(None, srcSystem=245, srcComponent=191)
    autopilot = Autopilot(1_777_626_000_000_000)
    with on_udp(autopilot, *peer.getsockname()):
        data, sender = peer.recvfrom(2000)
        (heartbeat,) = mav.parse_buffer(data)
        assert heartbeat.get_type() == "HEARTBEAT"
        requests = [
            tables.MAVLink_command_long_message(1, 1, 511, 0, 30, 20_000, 0, 0, 0, 0, 0),
            tables.MAVLink_timesync_message(0, 123_456_789),
            tables.MAVLink_param_request_read_message(1, 1, b"CAM1_TYPE", -1),
            tables.MAVLink_command_long_message(1, 1, 203, 0, 0, 0, 0, 0, 1, 0, 0),
        ]
        for request in requests:
            peer.sendto(request.pack(mav), sender)
        wanted = {"COMMAND_ACK", "TIMESYNC", "PARAM_VALUE", "CAMERA_FEEDBACK", "ATTITUDE"}
        found = collect(peer, wanted, mav)
    assert wanted <= set(found)
    assert found["COMMAND_ACK"].result == 0
    assert found["TIMESYNC"].ts1 == 123_456_789
    assert found["TIMESYNC"].tc1 > 0
    assert found["PARAM_VALUE"].param_id == "CAM1_TYPE"
    assert found["CAMERA_FEEDBACK"].img_idx == 1
    assert autopilot.interval_s == {30: 0.02}


def test_unknown_messages_and_commands_are_denied() -> None:
    mav = tables.MAVLink(None, srcSystem=245, srcComponent=191)
    autopilot = Autopilot(0)
    answers = [
        mav.parse_buffer(
            autopilot.receive(
                tables.MAVLink_command_long_message(1, 1, command, 0, 9999, 1e5, 0, 0, 0, 0, 0).pack(mav), 1.0
            )
        )[0]
        for command in (511, 400)
    ]
    assert [a.result for a in answers] == [4, 3]


@pytest.fixture
def udp_peer() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        yield peer


@pytest.fixture
def receiver_port() -> Iterator[tuple[Receiver, Any]]:
    receiver = Receiver(9)
    with on_pty(receiver) as path, serial.Serial(path, timeout=PATIENCE_S) as port:
        yield receiver, port


def answers_until(port: Any, identity: str) -> list[Any]:
    found = []
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        _, message = UBXReader(port).read()
        found.append(message)
        if message.identity == identity:
            break
    return found


def test_the_receiver_answers_on_a_pseudo_terminal(receiver_port: tuple[Receiver, Any]) -> None:
    receiver, port = receiver_port
    port.write(UBXMessage("MON", "MON-VER", POLL).serialize())
    version = answers_until(port, "MON-VER")[-1]
    assert version.hwVersion.startswith(b"00190000")
    port.write(UBXMessage.config_set(1, 0, [("CFG_MSGOUT_UBX_RXM_RAWX_USB", 1)]).serialize())
    acknowledged = answers_until(port, "ACK-ACK")[-1]
    assert (acknowledged.clsID, acknowledged.msgID) == (0x06, 0x8A)
    assert receiver.settings == {"CFG_MSGOUT_UBX_RXM_RAWX_USB": 1}
    port.write(UBXMessage.config_poll(0, 0, ["CFG_MSGOUT_UBX_RXM_RAWX_USB"]).serialize())
    assert answers_until(port, "CFG-VALGET")[-1].CFG_MSGOUT_UBX_RXM_RAWX_USB == 1


def test_generation_8_knows_no_valset() -> None:
    receiver = Receiver(8)
    asked = UBXMessage.config_set(1, 0, [("CFG_RATE_MEAS", 200)]).serialize()
    assert UBXReader.parse(receiver.receive(asked, 0.0)).identity == "ACK-NAK"
    asked = UBXMessage("CFG", "CFG-MSG", SET, msgClass=2, msgID=0x15, rateUART1=1).serialize()
    assert UBXReader.parse(receiver.receive(asked, 0.0)).identity == "ACK-ACK"
    assert (2, 0x15) in receiver.rates
