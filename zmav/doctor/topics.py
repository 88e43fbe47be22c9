"""What ``zmav doctor`` looks at, each once: nothing is told that is not one of these.

docs/doctor.md says of each what it means, when it is red, and what to do.
"""

from __future__ import annotations

from dataclasses import dataclass

from zmav.doctor.findings import FLEET, HOST, LINK, NETWORK, VEHICLE, Finding, Level


@dataclass(frozen=True)
class Topic:
    """What a line of the page is about, and under which heading it stands."""

    name: str
    group: str

    def well(self, found: str, who: str = "") -> Finding:
        return self._finding(Level.OK, found, "", who)

    def advise(self, found: str, advice: str, who: str = "") -> Finding:
        """No fault, but something to do, or something that could not be looked at."""
        return self._finding(Level.ADVICE, found, advice, who)

    def wrong(self, found: str, advice: str, who: str = "") -> Finding:
        return self._finding(Level.RED, found, advice, who)

    def _finding(self, level: Level, found: str, advice: str, who: str) -> Finding:
        group = VEHICLE if self.group == HOST and who else self.group  # a vehicle's computer is looked at as our own
        return Finding(level, self.name, found, advice, who, group)


PACKAGES = Topic("packages", HOST)
COMPUTER = Topic("computer", HOST)
DISK = Topic("disk", HOST)
MEMORY = Topic("memory", HOST)
LOAD = Topic("load", HOST)
HEAT = Topic("heat", HOST)
POWER = Topic("power", HOST)
TIME = Topic("time", HOST)
CREDENTIALS = Topic("credentials", HOST)
FOLDER = Topic("credentials folder", HOST)
FILE = Topic("fleet file", HOST)

DEVICE = Topic("device", LINK)
PERMISSION = Topic("permission", LINK)
HOLDER = Topic("holder", LINK)
CONSOLE = Topic("console", LINK)
MODEM = Topic("modem manager", LINK)
OPEN = Topic("link", LINK)
TRAFFIC = Topic("traffic", LINK)
SYSTEM = Topic("system", LINK)
AUTOPILOT = Topic("autopilot", LINK)

ROUTER = Topic("router", NETWORK)
WAY = Topic("way", NETWORK)
WEAKEST = Topic("weakest", NETWORK)
ROSTER = Topic("roster", NETWORK)
ROSTERS = Topic("routers' rosters", NETWORK)

PRESENCE = Topic("presence", VEHICLE)
IDENTITY = Topic("identity", VEHICLE)
HEARING = Topic("autopilot link", VEHICLE)
READINESS = Topic("readiness", VEHICLE)
BATTERY = Topic("battery", VEHICLE)
CORRECTIONS = Topic("corrections", VEHICLE)
CLOCK = Topic("clock", VEHICLE)
FAILSAFE = Topic("failsafe", VEHICLE)
TERRAIN = Topic("terrain", VEHICLE)
NEAR = Topic("traffic nearby", VEHICLE)
REMOTE_ID = Topic("remote id", VEHICLE)
GIMBAL = Topic("gimbal", VEHICLE)
CERTIFICATE = Topic("certificate", VEHICLE)

VEHICLES = Topic("vehicles", FLEET)
SYSIDS = Topic("system ids", FLEET)
NAMES = Topic("names", FLEET)
VERSIONS = Topic("versions", FLEET)
FIRMWARE = Topic("firmware", FLEET)
AGENTS = Topic("agents", FLEET)
AIRCRAFT = Topic("aircraft", FLEET)
DOCTOR = Topic("doctor", FLEET)

TOPICS: tuple[Topic, ...] = tuple(each for each in vars().copy().values() if isinstance(each, Topic))
