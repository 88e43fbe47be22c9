"""The bridge's copy of one vehicle's parameters: asked of the vehicle's agent once for all clients, and kept up to date
by the PARAM_VALUEs that the autopilot says anyway.
"""

from __future__ import annotations

import asyncio
import math
import struct
import time
from typing import Any, NamedTuple

import zmav
from ground.gcs.answerer import Ground
from zmav import wire
from zmav.errors import Forbidden, ZmavError
from zmav.mavlink import paramvalue
from zmav.mavlink.frame import HEADER_V1, HEADER_V2, MAGIC_V2, build_frame
from zmav.mavlink.paramvalue import ParamEncoding
from zmav.services.params.values import NO_INDEX

FRESH = 2.0
"""s after which the vehicle is asked again whether its set is still the same: a line, where it is"""
LOOK_AGAIN = 3.0
"""s between two looks at a set that is still being read, where we may not ask for the reading"""
LAYOUT = struct.Struct("<4sHH16sB")
"""PARAM_VALUE: value, count, index, name, type"""


class ParamValue(NamedTuple):
    """What a PARAM_VALUE says."""

    name: str
    raw: bytes
    type: int
    place: int
    of: int


def read_value(data: bytes) -> ParamValue:
    """Of a frame that is one; of what is cut short, zeros."""
    start = HEADER_V2 if data[0] == MAGIC_V2 else HEADER_V1
    payload = data[start : start + data[1]][: LAYOUT.size].ljust(LAYOUT.size, b"\0")
    raw, count, index, name, kind = LAYOUT.unpack(payload)
    return ParamValue(name.partition(b"\0")[0].decode("ascii", "replace"), raw, kind, index, count)


class ParamCopy:
    """Of the autopilot of one system. Lives on the event loop."""

    def __init__(self, sysid: int, vehicle: zmav.Vehicle, ground: Ground) -> None:
        self.sysid, self.vehicle, self._ground = sysid, vehicle, ground
        self._message = ground.dialect.message("PARAM_VALUE")
        self._held: dict[str, wire.Param] = {}
        self._index: dict[str, int] = {}
        self._names: list[str] = []
        self._encoding: ParamEncoding | None = None
        self._at = -math.inf
        """monotonic s at which the vehicle's agent was last asked, in vain or not"""
        self._reading: asyncio.Task[None] | None = None

    @property
    def names(self) -> list[str]:
        """All of them, by index; empty as long as the set is not known."""
        return self._names

    @property
    def fresh(self) -> bool:
        return bool(self._names) and time.monotonic() - self._at < FRESH

    @property
    def encoding(self) -> ParamEncoding:
        if self._encoding is not None:
            return self._encoding
        state = self.vehicle.last_state
        return ParamEncoding.BYTEWISE if state and state.autopilot == "px4" else ParamEncoding.C_CAST

    def param(self, name: str) -> wire.Param | None:
        return self._held.get(name)

    async def refresh(self) -> None:
        """Have the whole set, as the vehicle has it now; waits until it has all of it. Who asks while somebody waits
        waits with him. Raises what orders raise.
        """
        if self.fresh:
            return
        if self._reading is None:
            self._reading = asyncio.get_running_loop().create_task(self._read())
            self._reading.add_done_callback(self._read_ended)
        await asyncio.shield(self._reading)

    def close(self) -> None:
        if self._reading is not None:
            self._reading.cancel()

    async def _read(self) -> None:
        params = self.vehicle.params
        while True:
            try:
                table = await params.list()
                break
            except Forbidden:  # a viewer may look, but not ask for a reading: one that is under way will end
                await asyncio.sleep(LOOK_AGAIN)
        self._at = time.monotonic()
        self._encoding = ParamEncoding(table.encoding) if table.encoding else None
        self._held = {param.name: param for param in table.params}
        self._names = list(self._held)
        self._index = {name: index for index, name in enumerate(self._names)}

    def _read_ended(self, task: asyncio.Task[None]) -> None:
        self._reading = None
        if not task.cancelled():
            task.exception()  # looked at: nobody may be left who waits for it

    # Changes.

    def hear(self, heard: ParamValue) -> bool:
        """Take in what the autopilot said; True where it is news."""
        if not self._names:
            return False
        kind = paramvalue.type_name(heard.type)
        if kind is None or heard.name not in self._held:
            if heard.place != NO_INDEX and kind is not None:
                self._at = -math.inf  # there may be another set now
            return False
        value = paramvalue.value_of(heard.raw, kind, self.encoding)
        return self.take(wire.Param(name=heard.name, value=value, type=kind))

    def take(self, param: wire.Param) -> bool:
        """Take in a value that the vehicle has now; True where it is news."""
        held = self._held.get(param.name)
        if held is None or held == param:
            return False
        self._held[param.name] = param
        self.vehicle.params.note(param)
        return True

    # Frames.

    def is_as(self, name: str, raw: bytes, kind: int) -> bool:
        """Its value and type are these, as they travel."""
        param = self._held.get(name)
        return param is not None and (self._raw(param), paramvalue.type_number(param.type)) == (raw, kind)

    def pack(self, name: str, **fields: Any) -> bytes:
        """A frame in the autopilot's name."""
        return self._ground.pack(self.sysid, self._ground.component(self.sysid), name, **fields)

    def frame(self, name: str) -> bytes | None:
        """Its PARAM_VALUE, as the autopilot says it; None: there is none of that name."""
        param = self._held.get(name)
        return None if param is None else self.frame_of(param, self._index[name])

    def frame_of(self, param: wire.Param, index: int = NO_INDEX) -> bytes:
        kind = paramvalue.type_number(param.type)
        payload = LAYOUT.pack(self._raw(param), len(self._names), index, param.name.encode("ascii", "replace"), kind)
        return build_frame(self._message, payload, self.sysid, self._ground.component(self.sysid), 0)

    def _raw(self, param: wire.Param) -> bytes:
        if param.value is None:
            return struct.pack("<f", math.nan)
        try:
            return paramvalue.raw_of(param.name, param.value, param.type, self.encoding)
        except ZmavError:  # more than its type can hold: the autopilot said so all the same
            return struct.pack("<f", paramvalue.float32(float(param.value)))
