"""How a flight stack keeps and flies its missions: what the mission service needs to know of it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MissionRules:
    """The defaults are what the mission protocol promises of any autopilot."""

    mode: str | None = None
    """the mode that flies the mission; None: MAV_CMD_MISSION_START alone"""
    start_command: bool = True
    """MAV_CMD_MISSION_START begins it (a copter on the ground takes off by it)"""
    home_first: bool = False
    """item 0 on the autopilot is home, and no part of the mission"""
    window: int = 1
    """items of a download that may be asked for at once: more than one where each request stands for itself"""
    set_by_command: bool = True
    """it knows MAV_CMD_DO_SET_MISSION_CURRENT; False: the message MISSION_SET_CURRENT alone"""
    mission_frame: bool = False
    """items without a place are taken in MAV_FRAME_MISSION only"""
    never_placed: frozenset[str] = frozenset()
    """commands that it takes without a place only, though MAVLink gives them one"""
    exact: bool = True
    """every item is kept as it was sent; False: parameters are rounded, or left out where the vehicle ignores them"""
