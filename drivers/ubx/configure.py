"""Configuration of u-blox receivers: what to send and how to read the answer.

Source: u-blox interface descriptions of the F9 HPG 1.32 (CFG-VALSET, CFG-VALGET) and the M8 protocol 15 to
23.01 (CFG-MSG, CFG-RATE); MON-VER of both.
"""

import re
import struct
from dataclasses import dataclass

from drivers.ubx.decode import ACK_ACK, ACK_NAK, NAV_PVT, RXM_RAWX, RXM_SFRBX, TIM_TM2
from photocal.base.errors import DeviceError

MON_VER, CFG_MSG, CFG_RATE, CFG_VALSET, CFG_VALGET = 0x0A04, 0x0601, 0x0608, 0x068A, 0x068B
MESSAGES = {"NAV-PVT": NAV_PVT, "RXM-RAWX": RXM_RAWX, "RXM-SFRBX": RXM_SFRBX, "TIM-TM2": TIM_TM2}


def read_version(payload: bytes) -> tuple[int, str]:
    """Read the generation (8, 9, 10) and the software of a receiver from the answer to a poll of MON-VER.

    raises DeviceError: when the receiver belongs to no generation that can be configured here.
    """
    texts = [_text(payload[:30]), _text(payload[30:40])]
    texts += [_text(payload[at : at + 30]) for at in range(40, len(payload), 30)]
    software, hardware, *extensions = texts
    hardware_generations = {"00080000": 8, "00190000": 9, "000A0000": 10}
    generation = hardware_generations.get(hardware)
    if generation is None:
        protocol = re.search(r"PROTVER[ =]([0-9.]+)", " ".join(extensions))
        raise DeviceError(
            f"the receiver (hardware {hardware or 'unknown'}, software {software or 'unknown'}, protocol "
            f"{protocol[1] if protocol else 'unknown'}) cannot be configured: "
            "only generations 8, 9 and 10 can",
            "configure it with u-center and leave [link.ublox] out",
        )
    return generation, software


@dataclass(frozen=True)
class Step:
    """One request of a configuration.

    kind: message that ACK-ACK or ACK-NAK will name.
    poll: what asks for the setting afterwards.
    expected: settings that the answer must hold, by key (generation 9) or message (generation 8).
    """

    what: str
    frame: bytes
    kind: int
    poll: bytes
    expected: tuple[tuple[int, int], ...]


def steps(generation: int, port: str, messages: tuple[str, ...], rate_ms: int) -> list[Step]:
    """Return the requests that switch messages on and set the time between measurements.

    Settings go to the working memory only: they are gone with the next cold start.
    """
    from pyubx2 import POLL, SET, UBXMessage, cfgname2key

    if generation >= 9:
        wanted = [(f"CFG_MSGOUT_UBX_{name.replace('-', '_')}_{port.upper()}", 1) for name in messages]
        wanted.append(("CFG_RATE_MEAS", rate_ms))
        keys = tuple((int(cfgname2key(name)[0]), value) for name, value in wanted)
        ram = 1
        frame = UBXMessage.config_set(ram, 0, wanted).serialize()
        poll = UBXMessage.config_poll(0, 0, [name for name, _ in wanted]).serialize()
        return [Step("output and rate", frame, CFG_VALSET, poll, keys)]
    made = []
    for name in messages:
        kind = MESSAGES[name].to_bytes(2, "big")
        # Three bytes mean the port over which the request comes.
        frame = UBXMessage("CFG", "CFG-MSG", SET, payload=kind + b"\x01").serialize()
        poll = UBXMessage("CFG", "CFG-MSG", POLL, payload=kind).serialize()
        made.append(Step(name, frame, CFG_MSG, poll, ((MESSAGES[name], 1),)))
    frame = UBXMessage("CFG", "CFG-RATE", SET, measRate=rate_ms, navRate=1, timeRef=1).serialize()
    poll = UBXMessage("CFG", "CFG-RATE", POLL).serialize()
    return [*made, Step("rate", frame, CFG_RATE, poll, ((CFG_RATE, rate_ms),))]


def read_settings(kind: int, payload: bytes) -> dict[int, int]:
    """Read the answer to a poll of CFG-VALGET, CFG-MSG or CFG-RATE, see `Step.expected`."""
    if kind == CFG_VALGET:
        settings, at = {}, 4
        while at + 5 <= len(payload):
            (key,) = struct.unpack_from("<I", payload, at)
            # Bits 28 to 30 of a key tell the size of its value.
            width = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8}.get(key >> 28 & 7, 1)
            settings[key] = int.from_bytes(payload[at + 4 : at + 4 + width], "little")
            at += 4 + width
        return settings
    if kind == CFG_MSG and len(payload) == 8:
        return {int.from_bytes(payload[:2], "big"): max(payload[2:])}
    if kind == CFG_RATE and len(payload) == 6:
        return {CFG_RATE: int.from_bytes(payload[:2], "little")}
    return {}


def acknowledged(kind: int, payload: bytes) -> tuple[int, bool] | None:
    """Return which message was acknowledged and whether it was accepted; None for other messages."""
    if kind not in (ACK_ACK, ACK_NAK) or len(payload) != 2:
        return None
    return int.from_bytes(payload, "big"), kind == ACK_ACK


def _text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("ascii", "replace").strip()
