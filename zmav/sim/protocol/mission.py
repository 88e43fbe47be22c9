"""Missions: there is no mission store yet, and this says so in the protocol's own words.

Protocol: https://mavlink.io/en/services/mission.html. A download gives an empty list, clearing succeeds, an upload
is refused with MAV_MISSION_UNSUPPORTED.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from zmav.sim.protocol.channel import Channel
from zmav.sim.protocol.part import Answer, Part

ACCEPTED, UNSUPPORTED, INVALID_SEQUENCE = 0, 3, 13  # MAV_MISSION_RESULT


class MissionProtocol(Part):
    """Answers the MISSION_ messages; ``sender`` is the (system, component) that asked."""

    def answers(self) -> Mapping[str, Answer]:
        return {
            "MISSION_REQUEST_LIST": self.request_list,
            "MISSION_COUNT": self.count,
            "MISSION_CLEAR_ALL": self.clear_all,
            "MISSION_REQUEST": self.request_item,
            "MISSION_REQUEST_INT": self.request_item,
            "MISSION_ITEM": self.item,
            "MISSION_ITEM_INT": self.item,
        }

    def request_list(self, channel: Channel, msg: dict[str, Any], sender: tuple[int, int]) -> None:
        channel.send(
            "MISSION_COUNT",
            target_system=sender[0],
            target_component=sender[1],
            count=0,
            mission_type=msg["mission_type"],
        )

    def count(self, channel: Channel, msg: dict[str, Any], sender: tuple[int, int]) -> None:
        # A list of nothing is a list that can be kept.
        self._ack(channel, msg, sender, ACCEPTED if msg["count"] == 0 else UNSUPPORTED)

    def clear_all(self, channel: Channel, msg: dict[str, Any], sender: tuple[int, int]) -> None:
        self._ack(channel, msg, sender, ACCEPTED)

    def request_item(self, channel: Channel, msg: dict[str, Any], sender: tuple[int, int]) -> None:
        self._ack(channel, msg, sender, INVALID_SEQUENCE)

    def item(self, channel: Channel, msg: dict[str, Any], sender: tuple[int, int]) -> None:
        self._ack(channel, msg, sender, UNSUPPORTED)

    def _ack(self, channel: Channel, msg: dict[str, Any], sender: tuple[int, int], result: int) -> None:
        channel.send(
            "MISSION_ACK",
            target_system=sender[0],
            target_component=sender[1],
            type=result,
            mission_type=msg["mission_type"],
        )
