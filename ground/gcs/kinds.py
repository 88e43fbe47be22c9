"""What the bridge knows of each message of each component it hears, so that a frame's way is a few look-ups."""

from __future__ import annotations

import struct

from ground.feed import Origin
from zmav.mavlink import Dialect, MessageType
from zmav.mavlink.checksum import crc
from zmav.mavlink.frame import CHECKSUM, HEADER_V1, HEADER_V2, MAGIC_V1, MAGIC_V2, SIGNED

Place = tuple[str, str]
"""fleet and vehicle"""
HEARTBEAT = "HEARTBEAT"
MUST_ARRIVE = frozenset(
    {
        "STATUSTEXT",
        "PARAM_VALUE",
        "TIMESYNC",
        "AUTOPILOT_VERSION",
        "MESSAGE_INTERVAL",
        "PROTOCOL_VERSION",
        "HOME_POSITION",
        "GPS_GLOBAL_ORIGIN",
        "MISSION_ITEM_REACHED",
        "COMMAND_ACK",
        "CAMERA_INFORMATION",
        "CAMERA_SETTINGS",
        "CAMERA_IMAGE_CAPTURED",
        "VIDEO_STREAM_INFORMATION",
        "STORAGE_INFORMATION",
        "GIMBAL_MANAGER_INFORMATION",
        "COMPONENT_INFORMATION",
        "COMPONENT_INFORMATION_BASIC",
        "COMPONENT_METADATA",
        "PARAM_EXT_VALUE",
        "PARAM_EXT_ACK",
        "LOG_ENTRY",
        "LOG_DATA",
        "AVAILABLE_MODES",
        "EVENT",
        "CURRENT_EVENT_SEQUENCE",
        "RESPONSE_EVENT_ERROR",
    }
)
"""answers, words and events: said once. So is every message that is addressed to somebody"""
INSTANCES = {
    "ESC_INFO": "index",
    "ESC_STATUS": "index",
    "DEBUG": "ind",
    "ADSB_VEHICLE": "ICAO_address",
    "AIS_VESSEL": "MMSI",
    "OBSTACLE_DISTANCE": "sensor_type",
    "RC_CHANNELS_RAW": "port",
    "RC_CHANNELS_SCALED": "port",
    "GIMBAL_DEVICE_ATTITUDE_STATUS": "gimbal_device_id",
    "OPTICAL_FLOW": "sensor_id",
}
"""messages of which a component sends several, each about another thing, and the field that tells them apart, where the
definition itself does not say so"""
MOST_KINDS = 8192
"""invented names must not fill the memory"""


class Track:
    """One system heard of one vehicle's agent."""

    __slots__ = ("heard", "place", "sysid")

    def __init__(self, place: Place, sysid: int) -> None:
        self.place, self.sysid = place, sysid
        self.heard = 0.0
        """monotonic s"""


class Kind:
    """One message of one component of one vehicle."""

    __slots__ = ("beat", "ids", "instance", "must", "name", "origin", "source", "target_at", "track", "watched")

    def __init__(self, origin: Origin, dialect: Dialect, track: Track, watched: frozenset[str]) -> None:
        self.origin, self.track = origin, track
        self.name = (origin.sysid, origin.compid, origin.message)
        self.source = origin.sysid << 8 | origin.compid
        self.ids = bytes((origin.sysid, origin.compid))
        message = dialect.by_name.get(origin.message)
        self.target_at = message.target_system if message is not None else None
        self.instance = _instance_of(message) if message is not None else None
        self.beat = origin.message == HEARTBEAT
        self.must = self.target_at is not None or origin.message in MUST_ARRIVE
        self.watched = origin.message in watched

    def is_whole(self, data: bytes) -> bool:
        """The bytes look like a frame of that component: nobody else's, nor cut."""
        size = len(data)
        if size >= 12 and data[0] == MAGIC_V2:
            return data[5:7] == self.ids and size == (25 if data[2] & 1 else 12) + data[1]
        return size >= 8 and data[0] == MAGIC_V1 and data[3:5] == self.ids and size == 8 + data[1]

    def about(self, data: bytes) -> object:
        """What a frame is about: a newer one about the same takes its place."""
        if self.instance is None:
            return self.name
        start = HEADER_V2 if data[0] == MAGIC_V2 else HEADER_V1
        end = start + data[1]
        return (*self.name, data[start + self.instance.start : min(start + self.instance.stop, end)])

    def target(self, data: bytes) -> int:
        """The system it is for; 0: everybody."""
        if self.target_at is None or self.target_at >= data[1]:
            return 0
        return data[(HEADER_V2 if data[0] == MAGIC_V2 else HEADER_V1) + self.target_at]


def _instance_of(message: MessageType) -> slice | None:
    """The bytes of the payload that tell which of several it is about; None: there is but one."""
    before, told = "<", INSTANCES.get(message.name)
    for field in message.wire_fields:
        start, before = struct.calcsize(before), before + field.code
        if field.instance or field.name == told:
            return slice(start, struct.calcsize(before))
    return None


OVERTAKEN = 32
"""a frame from so far back at most came late, or twice: it shows no loss"""
_ZEROS = bytes(300)


class Numbering:
    """One component's numbers as one client sees them. ``heard`` is the last one that came, ``sent`` that it got; -1:
    none yet. Not thread-safe.
    """

    __slots__ = ("_heard", "_lost", "_sent")

    def __init__(self, heard: int = -1, sent: int = -1) -> None:
        self._heard, self._sent, self._lost = heard, sent, 0

    def came(self, seq: int) -> None:
        """A frame came, whether the client will get it or not."""
        step = (seq - self._heard) & 0xFF
        if self._heard >= 0 and (step == 0 or step >= 0x100 - OVERTAKEN):
            return
        if self._heard >= 0 and step < 0x80:
            self._lost += step - 1
        self._heard = seq

    def next(self) -> int:
        """The number of the frame that the client gets next."""
        self._sent = (self._sent + 1 + self._lost) & 0xFF
        self._lost = 0
        return self._sent


def sequence_of(data: bytes) -> int:
    return data[4] if data[0] == MAGIC_V2 else data[2]


def renumbered(data: bytes, seq: int) -> bytes:
    """The frame with another sequence number. A signed one stays as it is: nobody but its sender can sign it.

    The checksum is linear in the frame: it changes by the checksum, begun at zero, of what is changed. So the frame
    need not be known, and one that came damaged stays so.
    """
    version2 = data[0] == MAGIC_V2
    at = 4 if version2 else 2
    change = data[at] ^ seq
    if not change or (version2 and data[2] & SIGNED):
        return data
    end = len(data) - CHECKSUM
    # What follows the number: the rest of header and payload, and the message's crc_extra.
    delta = crc(bytes((change,)) + _ZEROS[: end - at], 0)
    checked = (data[end] | data[end + 1] << 8) ^ delta
    return b"".join((data[:at], bytes((seq,)), data[at + 1 : end], checked.to_bytes(CHECKSUM, "little")))
