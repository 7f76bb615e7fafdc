"""A simulated u-blox receiver: version, configuration of generations 8 and 9, acknowledgements.

It reads and writes with pyubx2, so that what we send is judged by another program than our own.
"""

from __future__ import annotations

from typing import Any

VERSIONS = {
    7: ("1.00 (59842)", "00070000", ["PROTVER 14.00"]),
    8: ("EXT CORE 3.01 (111141)", "00080000", ["FWVER=HPG 1.43", "PROTVER=20.30", "MOD=NEO-M8P-2"]),
    9: ("EXT CORE 1.00 (0fa0b0)", "00190000", ["FWVER=HPG 1.32", "PROTVER=27.31", "MOD=ZED-F9P"]),
}
_PVT_EVERY_S = 0.2


class Receiver:
    """The state of the receiver's side of a line."""

    def __init__(self, generation: int, *, refuses: bool = False, forgets: bool = False) -> None:
        self._generation = generation
        self._refuses = refuses
        self._forgets = forgets
        self._pending = b""
        self._pvt_due_s = 0.0
        self.settings: dict[str, int] = {}
        self.rates: dict[tuple[int, int], int] = {}
        self.measurement_ms = 1000
        self.corrections = b""
        self.heard: list[str] = []

    def due(self, time_s: float) -> bytes:
        """Return what is sent of its own accord up to a moment, seconds after the start."""
        from pyubx2 import GET, UBXMessage

        if time_s < self._pvt_due_s:
            return b""
        self._pvt_due_s = time_s + _PVT_EVERY_S
        pvt = UBXMessage(
            "NAV", "NAV-PVT", GET, year=2026, month=5, day=1, hour=9, second=round(time_s) % 60, validDate=1,
            validTime=1, fullyResolved=1, fixType=3, gnssFixOk=1, carrSoln=2, numSV=19, lat=47.5, lon=8.5,
            height=510000, hMSL=462000, hAcc=14, vAcc=20,
        )  # fmt: skip
        return bytes(pvt.serialize())

    def receive(self, data: bytes, _time_s: float) -> bytes:
        """Take bytes of the host; return the answers."""
        from pyubx2 import SET, UBXMessage, UBXReader

        self._pending += data
        out = b""
        while len(self._pending) >= 8:
            if self._pending[:2] != b"\xb5\x62":
                # Corrections come over the same line.
                place = self._pending.find(b"\xb5\x62", 1)
                cut = place if place >= 0 else len(self._pending)
                self.corrections += self._pending[:cut]
                self._pending = self._pending[cut:]
                continue
            end = 8 + int.from_bytes(self._pending[4:6], "little")
            if len(self._pending) < end:
                break
            frame, self._pending = self._pending[:end], self._pending[end:]
            poll = frame[2:4] == b"\x06\x8b" or len(frame) in (8, 10)
            message: Any = UBXReader.parse(frame, msgmode=2 if poll else SET)
            assert isinstance(message, UBXMessage)  # noqa: S101
            self.heard.append(message.identity)
            out += self._answer(message, frame)
        if self._pending and not b"\xb5".startswith(self._pending[:1]):
            self.corrections, self._pending = self.corrections + self._pending, b""
        return out

    def _answer(self, message: Any, frame: bytes) -> bytes:
        payload = frame[6:-2]
        identity = message.identity
        if identity == "MON-VER":
            software, hardware, extensions = VERSIONS[self._generation]
            texts = [software.encode().ljust(30, b"\0"), hardware.encode().ljust(10, b"\0")]
            texts += [text.encode().ljust(30, b"\0") for text in extensions]
            return _message(b"\x0a\x04", b"".join(texts))
        if identity == "CFG-VALSET" and self._generation >= 9:
            values = {k: v for k, v in vars(message).items() if k.startswith("CFG_") and isinstance(v, int)}
            return self._set(frame, lambda: self.settings.update(values))
        if identity == "CFG-VALGET" and self._generation >= 9:
            keys = [int.from_bytes(payload[at : at + 4], "little") for at in range(4, len(payload), 4)]
            answer = b"\x01\0\0\0" + b"".join(self._value(key) for key in keys)
            return _message(b"\x06\x8b", answer) + self._ack(frame)
        if identity == "CFG-MSG" and self._generation == 8:
            key = payload[0], payload[1]
            if len(payload) == 2:
                rates = bytes((*key, 0, self.rates.get(key, 0), 0, 0, 0, 0))
                return _message(b"\x06\x01", rates) + self._ack(frame)
            return self._set(frame, lambda: self.rates.update({key: payload[2]}))
        if identity == "CFG-RATE" and self._generation == 8:
            if not payload:
                rate = self.measurement_ms.to_bytes(2, "little") + b"\1\0\1\0"
                return _message(b"\x06\x08", rate) + self._ack(frame)

            def keep() -> None:
                self.measurement_ms = int.from_bytes(payload[:2], "little")

            return self._set(frame, keep)
        return self._ack(frame, good=False)

    def _set(self, frame: bytes, keep: Any) -> bytes:
        if not self._refuses and not self._forgets:
            keep()
        return self._ack(frame, good=not self._refuses)

    def _value(self, key: int) -> bytes:
        from pyubx2 import cfgkey2name

        name, kind = cfgkey2name(key)
        return key.to_bytes(4, "little") + self.settings.get(name, 0).to_bytes(int(kind[1:]), "little")

    @staticmethod
    def _ack(frame: bytes, *, good: bool = True) -> bytes:
        return _message(b"\x05\x01" if good else b"\x05\x00", frame[2:4])


def _message(kind: bytes, payload: bytes) -> bytes:
    from pyubx2 import GET, UBXMessage

    return bytes(UBXMessage(kind[:1], kind[1:], GET, payload=payload).serialize())
