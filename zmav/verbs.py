"""The verbs of ``do/{verb}``, listed once: what each takes, who may give it and what it does to a stream of setpoints.

The services register what does the work; the command line and the key reference are derived from :data:`VERBS`.
:data:`SWARM_VERBS` are those of ``swarm/{verb}``, which the planning agent answers.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from zmav import keys, wire


class Access(enum.Enum):
    """What an order needs and does."""

    READ = "read"
    """changes nothing on the vehicle: anybody, at any time"""
    CHANGE = "change"
    """changes something but moves nothing: while somebody holds the lease, only with that lease"""
    MOVE = "move"
    """moves or arms the vehicle: as ``change``, and the stream of setpoints is over"""
    PAYLOAD = "payload"
    """moves what the vehicle carries and never the vehicle: whatever lease there is, which stays"""
    OPEN = "open"
    """makes it safe: open to everybody, ends the stream and a stranger's lease"""


FLYING = (keys.OPERATOR, keys.PLANNER, keys.AGENT)
CONFIGURING = (keys.OPERATOR,)
"""changes the autopilot itself or its files, or can: ``command`` carries any MAV_CMD"""
GIVEN = (keys.PLANNER, keys.AGENT)
"""who gets what ``[rights]`` of a fleet file gives"""
LOOKING = (*FLYING, keys.VIEWER)
"""a word or two over the autopilot's link; what occupies it for longer is not for viewers"""


@dataclass(frozen=True)
class Verb:
    name: str
    args: type[wire.Order]
    access: Access
    doc: str
    writers: tuple[str, ...] = FLYING
    """the roles that may give it, where the vehicle has credentials"""
    grantable: bool = False
    """a fleet file may give it to planners and to a vehicle's own programs: see :class:`zmav.config.Rights`"""
    version: int = 1
    """of its arguments: see :class:`zmav.keys.Channel`"""


VERBS: dict[str, Verb] = {
    verb.name: verb
    for verb in (
        Verb("arm", wire.Arm, Access.MOVE, "wait until ready, arm"),
        Verb("disarm", wire.Order, Access.OPEN, "disarm on the ground"),
        Verb("takeoff", wire.Takeoff, Access.MOVE, "climb to alt_rel metres above home"),
        Verb("goto", wire.GoTo, Access.MOVE, "fly to a point and wait for the arrival"),
        Verb("hold", wire.Order, Access.OPEN, "stop where it is"),
        Verb("land", wire.Order, Access.OPEN, "land where it is"),
        Verb("rtl", wire.Order, Access.OPEN, "return to launch"),
        Verb("set_mode", wire.SetMode, Access.MOVE, "enter a flight mode by name"),
        Verb("command", wire.RunCommand, Access.MOVE, "any MAV_CMD by name", CONFIGURING),
        Verb("reboot", wire.Order, Access.CHANGE, "restart the autopilot", CONFIGURING),
        Verb("servo", wire.SetServo, Access.CHANGE, "one output to a PWM", CONFIGURING, True),
        Verb("camera_trigger", wire.CameraTrigger, Access.CHANGE, "pictures by distance, or no more"),
        Verb("gimbal_point", wire.PointGimbal, Access.PAYLOAD, "look at a place or a vehicle", CONFIGURING),
        Verb("gimbal_turn", wire.TurnGimbal, Access.PAYLOAD, "turn the gimbal, or back", CONFIGURING),
        Verb("gimbal_release", wire.Order, Access.PAYLOAD, "look no more, give the gimbal back", CONFIGURING),
        Verb("gimbal_status", wire.Order, Access.READ, "where the gimbal looks, who controls it", LOOKING),
        Verb("param_set", wire.ParamSet, Access.CHANGE, "set a parameter and read it back", CONFIGURING),
        Verb("param_load", wire.ParamLoad, Access.CHANGE, "set many parameters", CONFIGURING),
        Verb("param_refresh", wire.ParamRefresh, Access.READ, "read all parameters again"),
        Verb("mission_upload", wire.MissionUpload, Access.CHANGE, "replace mission, fence or rally", CONFIGURING, True),
        Verb("mission_download", wire.MissionRefresh, Access.READ, "read the mission, fence or rally points again"),
        Verb("mission_clear", wire.MissionClear, Access.CHANGE, "clear mission, fence or rally", CONFIGURING, True),
        Verb("mission_start", wire.MissionStart, Access.MOVE, "fly the mission"),
        Verb("mission_current", wire.MissionJump, Access.MOVE, "go on with another item"),
        Verb("terrain_put", wire.TerrainPut, Access.CHANGE, "keep pieces of ground for the autopilot", CONFIGURING),
        Verb("terrain_clear", wire.Order, Access.CHANGE, "forget the pieces of ground", CONFIGURING),
        Verb("file_list", wire.FilePath, Access.READ, "list a directory of the autopilot", LOOKING),
        Verb("file_get", wire.FileGet, Access.READ, "fetch a file of the autopilot"),
        Verb("file_put", wire.FilePut, Access.CHANGE, "write a file of the autopilot", CONFIGURING),
        Verb("file_remove", wire.FilePath, Access.CHANGE, "remove a file of the autopilot", CONFIGURING),
        Verb("file_mkdir", wire.FilePath, Access.CHANGE, "make a directory on the autopilot", CONFIGURING),
        Verb("file_rmdir", wire.FilePath, Access.CHANGE, "remove an empty directory of the autopilot", CONFIGURING),
        Verb(
            "file_cancel",
            wire.Order,
            Access.CHANGE,
            "end the transfer of a file or log that is under way, or the first that waits",
        ),
        Verb("log_list", wire.LogList, Access.READ, "list the autopilot's logs", LOOKING),
        Verb("log_get", wire.LogGet, Access.READ, "fetch a log of the autopilot"),
        Verb("log_erase", wire.LogErase, Access.CHANGE, "erase all logs of the autopilot", CONFIGURING),
        Verb("lease", wire.TakeLease, Access.READ, "take or renew the right to command alone"),
        Verb("release", wire.DropLease, Access.READ, "give the lease back"),
        Verb(
            "revoke", wire.RevokeLease, Access.OPEN, "an operator ends anybody's lease; the vehicle holds", CONFIGURING
        ),
        Verb("ping", wire.Order, Access.READ, "answer at once", LOOKING),
    )
}

GRANTABLE = frozenset(verb.name for verb in VERBS.values() if verb.grantable)
PLANNING = (keys.OPERATOR, keys.PLANNER)
SWARM_VERBS: dict[str, Verb] = {
    verb.name: verb
    for verb in (
        Verb("submit", wire.swarm.Submit, Access.MOVE, "take a goal into the book", PLANNING),
        Verb("preview", wire.swarm.Preview, Access.READ, "what would be flown for a goal", (keys.ANYONE,)),
        Verb("pause", wire.swarm.GoalId, Access.OPEN, "come to rest along what is flown; the goals stay", PLANNING),
        Verb("resume", wire.swarm.GoalId, Access.MOVE, "go on with what was paused", PLANNING),
        Verb("abort", wire.swarm.GoalId, Access.OPEN, "come to rest and drop every goal", PLANNING),
        Verb("cancel", wire.swarm.GoalId, Access.OPEN, "drop one goal; its vehicles come to rest", PLANNING),
        Verb("obstacle", wire.swarm.GiveObstacle, Access.CHANGE, "something to keep clear of, or no more", PLANNING),
        Verb("status", wire.Order, Access.READ, "who is in charge, its book, its fleet", (keys.ANYONE,)),
    )
}
