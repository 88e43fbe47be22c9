"""MAVLink: frames out of bytes, messages out of frames, and the way back."""

from __future__ import annotations

from zmav.mavlink.codec import MavMessage, Packer, decode, describe, encode, targets
from zmav.mavlink.commands import CommandParam, CommandType, command_type
from zmav.mavlink.definitions import load_dialect
from zmav.mavlink.dialect import Dialect, Field, MessageType
from zmav.mavlink.frames import Frame, SourceCounters, SplitCounters, Splitter, parse_frame

__all__ = [
    "CommandParam",
    "CommandType",
    "Dialect",
    "Field",
    "Frame",
    "MavMessage",
    "MessageType",
    "Packer",
    "SourceCounters",
    "SplitCounters",
    "Splitter",
    "command_type",
    "decode",
    "describe",
    "encode",
    "load_dialect",
    "parse_frame",
    "targets",
]
