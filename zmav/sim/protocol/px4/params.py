"""PX4's way with the parameter protocol: integers bytewise, a hash of all of them, and types that must be right.

Protocol: https://mavlink.io/en/services/parameter.html (PX4: MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE)
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable
from typing import Any

from zmav.sim.protocol.channel import Channel, Sender
from zmav.sim.protocol.params import NO_INDEX, ParamProtocol, ParamStore

HASH = "_HASH_CHECK"
_UINT32, _INT32, _REAL32 = 5, 6, 9  # MAV_PARAM_TYPE


def from_field(number: float, kind: int) -> float:
    """The value behind the float field."""
    return number if kind == _REAL32 else float(struct.unpack("<i", struct.pack("<f", number))[0])


class Px4ParamProtocol(ParamProtocol):
    """Answers the PARAM_ messages; ``complain(text)`` is a STATUSTEXT."""

    def __init__(
        self, store: ParamStore, everyone: Callable[[], list[Channel]], complain: Callable[[str], None]
    ) -> None:
        super().__init__(store, everyone, self._send_hash)
        self._complain = complain

    def request_read(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if msg["param_index"] < 0 and msg["param_id"] == HASH:
            self._send_hash(channel)
        elif msg["param_index"] < 0 and msg["param_id"] in self.store:
            self._send(channel, msg["param_id"], self.store.index[msg["param_id"]])
        else:
            super().request_read(channel, msg, sender)

    def set(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        """Store and tell everyone; what names another type than the parameter's is refused with a text."""
        name = msg["param_id"]
        if name == HASH:
            if struct.pack("<f", msg["param_value"]) == struct.pack("<I", self.hash()):
                channel.params_next = None  # the client has them all
            return
        if name not in self.store:
            self._complain(f"unknown param: {name}")
            return
        kind = self.store.type_of(name)
        if msg["param_type"] != kind:
            self._complain(f"param types mismatch param: {name}")
            return
        value = from_field(msg["param_value"], kind)
        if math.isfinite(value):
            self.store.set(name, value)
        for each in self._everyone():
            self._send(each, name, self.store.index[name])

    def hash(self) -> int:
        """A number that changes with any parameter."""
        sums = 0
        for name in self.store.names:
            kind = self.store.type_of(name)
            value = self.store[name]
            raw = struct.pack("<f", value) if kind == _REAL32 else struct.pack("<i", int(value))
            sums = zlib.crc32(raw, zlib.crc32(name.encode("ascii"), sums))
        return sums

    def _send_hash(self, channel: Channel) -> None:
        channel.send(
            "PARAM_VALUE",
            param_id=HASH,
            param_value=self.to_field(self.hash(), _UINT32),
            param_type=_UINT32,
            param_count=len(self.store),
            param_index=NO_INDEX,
        )

    def to_field(self, value: float, kind: int) -> float:
        """Bytewise."""
        if kind == _REAL32:
            return value
        raw = struct.pack("<I" if kind == _UINT32 else "<i", int(value))
        return float(struct.unpack("<f", raw)[0])
