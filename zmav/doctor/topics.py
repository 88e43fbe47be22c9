"""What ``zmav doctor`` looks at, each once: what it means, when it is red, and what to do.

Nothing is told that is not one of :data:`TOPICS`; ``zmav doctor --explain`` and docs/doctor.md are derived from them.
"""

from __future__ import annotations

from dataclasses import dataclass

from zmav.doctor.findings import FLEET, GROUPS, HOST, LINK, NETWORK, VEHICLE, Finding, Level


@dataclass(frozen=True)
class Topic:
    """``about``: what is looked at; ``red`` and ``amber``: when it is so; ``todo``: what to do about it."""

    name: str
    group: str
    about: str
    red: str
    todo: str
    amber: str = ""

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


PACKAGES = Topic(
    "packages",
    HOST,
    "the versions of Python, zmav and what carries it",
    "a package that zmav needs is not installed",
    "install zmav with its dependencies: `pip install zmav`",
)
COMPUTER = Topic(
    "computer",
    HOST,
    "a host's machine in one line: disk, memory, load, heat, clock. Below it stands a line for each trouble",
    "",
    "a host that tells nothing runs another zmav, or something else answers in its name: bring it up to date",
    amber="it tells nothing of itself, or nothing that can be read",
)
DISK = Topic(
    "disk",
    HOST,
    "room where the system, the fetched logs and (`--disk DIR`) the recordings lie",
    "less than 256 MB are free, or it is mounted read-only",
    "delete old recordings and logs, or move them; a card that became read-only is worn out: replace it",
    amber="less than 2 GB are free; a recorder stops at 1 GB",
)
MEMORY = Topic(
    "memory",
    HOST,
    "memory that programs can still have (MemAvailable)",
    "less than 64 MB",
    "see what takes it (`ps aux --sort -rss`), and end that",
    amber="less than a tenth",
)
LOAD = Topic(
    "load",
    HOST,
    "processes that want a core, over the last minute (the load average)",
    "",
    "see what is busy (`top`); planners and cameras belong on another host than a vehicle's",
    amber="more than 1.5 a core",
)
HEAT = Topic(
    "heat",
    HOST,
    "the hottest thermal zone",
    "",
    "give it a heat sink or air; at 80 °C a Raspberry Pi begins to slow down",
    amber="80 °C or more",
)
POWER = Topic(
    "power",
    HOST,
    "the supply, where the machine tells (a Raspberry Pi does): under-voltage and throttling",
    "the supply is too low, or the processor is slowed down, now",
    "power the computer by a BEC or converter of its own (5.1 V, 3 A for a Pi 4, 5 A for a Pi 5) with short leads",
    amber="it was so since the computer started",
)
TIME = Topic(
    "time",
    HOST,
    "whether a time server, GPS or PTP keeps the computer's clock (as systemd judges: the kernel reckons with less "
    "than 16 s of error)",
    "",
    "run chrony on every host; without an uplink, let all follow one of them: `allow` and `local stratum 10` there, "
    "`server ADDRESS iburst` on the others",
    amber="nothing keeps it; it is red only where clocks differ (clock)",
)
CREDENTIALS = Topic(
    "credentials",
    HOST,
    "the folder given by `--credentials`: whether it is whole, the certificate's end, the roster's word on it",
    "the folder cannot be used, the certificate has ended, ends within 30 days or is revoked",
    "where the authority is: `zmav mesh ca renew NAME`; carry the new folder here and start again",
)
FOLDER = Topic(
    "credentials folder",
    HOST,
    "who may write in the folder of the credentials",
    "others than its owner may",
    "`chmod go-w DIR`",
)
FILE = Topic(
    "fleet file",
    HOST,
    "the file given by `--file`, read as `zmav up` reads it, and this host's table in it",
    "it cannot be read, a field is unknown or wrong, the host is not in it, or two vehicles have one system id",
    "mend the field that is named; `zmav mesh config --file FILE --name NAME` shows what the network makes of it",
)

DEVICE = Topic(
    "device",
    LINK,
    "the serial device that the link names: whether it is there and is a serial port",
    "it is not there, or is something else",
    "look at the cable and at `ls -l /dev/serial/by-id`; name the port by that path, which stays",
)
PERMISSION = Topic(
    "permission",
    LINK,
    "whether the user who runs zmav (`--user`; for root, the user zmav where there is one) may open the device",
    "the user may not read and write it",
    "`sudo usermod -aG dialout USER` (the group that owns the device), then log in or start the service again",
)
HOLDER = Topic(
    "holder",
    LINK,
    "which process has the device open; only root sees other users' processes. While one has it, the device is not "
    "opened to listen",
    "another program than this vehicle's `zmav up` has it",
    "stop that program: `sudo systemctl disable --now UNIT`, or `kill PID`",
)
CONSOLE = Topic(
    "console",
    LINK,
    "whether the device is the kernel's console, or a login waits on it",
    "it is: both write into the autopilot's stream",
    "take `console=` with this port out of the kernel's command line (/boot/firmware/cmdline.txt on a Raspberry Pi), "
    "`sudo systemctl disable --now serial-getty@PORT`, and restart",
)
MODEM = Topic(
    "modem manager",
    LINK,
    "whether ModemManager runs and may probe a USB serial device as if it were a modem",
    "",
    'a udev rule with ENV{ID_MM_DEVICE_IGNORE}="1" for the device, or `sudo systemctl mask --now ModemManager`',
    amber="it may: for half a minute after plugging in, it writes AT commands to the autopilot",
)
OPEN = Topic(
    "link",
    LINK,
    "whether the link opens, and a serial one at which baud rate MAVLink is heard",
    "it does not open, nothing comes, or MAVLink is heard at another baud rate than the one that is given",
    'give the baud rate that is named: `link = "/dev/ttyAMA0,57600"` in the fleet file, or the autopilot\'s '
    "SERIALn_BAUD (ArduPilot), SER_TELn_BAUD (PX4)",
)
TRAFFIC = Topic(
    "traffic",
    LINK,
    "what came while it was listened to",
    "no byte, no MAVLink in the bytes, 20 % lost or more, more than 1 % damaged, or the kernel dropped datagrams",
    "baud rate, cable and ground; the autopilot's SERIALn_PROTOCOL 2 (ArduPilot), MAV_n_CONFIG (PX4); "
    "`sudo sysctl -w net.core.rmem_max=4194304`",
    amber="5 % lost or more",
)
SYSTEM = Topic(
    "system", LINK, "every MAVLink system heard, by its system and component id", "", "nothing: it is a list"
)
AUTOPILOT = Topic(
    "autopilot",
    LINK,
    "whether one of the systems heard is an autopilot",
    "none is",
    "is this the autopilot's port, and does it send HEARTBEAT there? of two, choose one by `--sysid`",
)

ROUTER = Topic(
    "router",
    NETWORK,
    "each router that is reached: its links, its endpoints, its version of Zenoh",
    "none answers, it tells nothing of itself, or its Zenoh is of another minor version than ours",
    "start `zmav up` (vehicle) or `zmav router` (ground), or name one with `-e`; install one version everywhere",
)
WAY = Topic(
    "way",
    NETWORK,
    "each link between two routers that is not good, as its two ends measure it",
    "it is down, no probe comes through, it loses 20 % or takes 150 ms a kilobyte",
    "antennas, distance, channel and power; `zmav mesh graph --watch` while you move one; docs/mesh.md",
    amber="it loses 5 % or takes 30 ms a kilobyte",
)
WEAKEST = Topic(
    "weakest",
    NETWORK,
    "the weakest of all links between routers",
    "",
    "nothing: where it is not good, a line of its own says so",
)
ROSTER = Topic(
    "roster",
    NETWORK,
    "our roster (who is in the fleet) against the routers'",
    "a router has a newer one, or none tells which it has",
    "`zmav mesh ca roster --fetch --credentials DIR`; start the routers with `--credentials`",
)
ROSTERS = Topic(
    "routers' rosters",
    NETWORK,
    "the routers' rosters against ours",
    "a router's is older than ours: who was turned out may still be let in there",
    "`zmav mesh ca roster --publish`; where it does not arrive, look at the links",
)

PRESENCE = Topic(
    "presence",
    VEHICLE,
    "whether the vehicle's state comes and its autopilot is heard; what it is, its firmware, system id and mode",
    "its state does not come any more, its autopilot is silent, or says that it is in trouble",
    "no state: is its computer on, and its router linked? silent: power, cable, port and baud rate; "
    "`zmav doctor --file FILE --name NAME` on the vehicle tells more",
)
IDENTITY = Topic(
    "identity",
    VEHICLE,
    "whether another vehicle has its name or system id, as the vehicle itself sees it",
    "one has: orders are refused",
    "give one another `--name`, or another MAV_SYSID (SYSID_THISMAV before ArduPilot 4.7, MAV_SYS_ID of PX4)",
    amber="somebody else speaks in its name",
)
HEARING = Topic(
    "autopilot link",
    VEHICLE,
    "the link to its autopilot, by what its agent counts",
    "20 % lost or more, more than 1 % damaged, or datagrams dropped by the kernel, while we listened",
    "fewer messages (`zmav rate`), a higher baud rate with flow control; cable and ground; net.core.rmem_max",
    amber="5 % lost or more",
)
READINESS = Topic(
    "readiness",
    VEHICLE,
    "whether it can be armed, and what is missing in the autopilot's own words; GPS",
    "it is not ready to arm, or GPS has no fix",
    "wait for GPS and EKF under open sky; `zmav echo NAME/event` shows its reasons as they come",
    amber="few satellites, a poor HDOP, or a position that is seconds old",
)
BATTERY = Topic(
    "battery",
    VEHICLE,
    "what is left of the battery, where the autopilot tells",
    "less than 15 %",
    "charge or change it",
    amber="less than 25 %",
)
CLOCK = Topic(
    "clock",
    VEHICLE,
    "its clock against ours, by the quickest of five round trips, and its clock against its GPS",
    "off by more than 0.1 s (and what the round trip leaves open), by more than 1 s from GPS, or it does not answer",
    "setpoints are dropped as too late or too early: let chrony keep all clocks (see time)",
)
FAILSAFE = Topic(
    "failsafe",
    VEHICLE,
    "the parameters that decide what it does when its companion is dead, or the ground silent (docs/failsafes.md)",
    "one of them leaves it flying, or they cannot be read",
    "set the parameter that is named: `zmav param set NAME PARAMETER=VALUE`",
    amber="a recommendation",
)
CERTIFICATE = Topic(
    "certificate",
    VEHICLE,
    "with `--credentials`: the vehicle's certificate",
    "it shows none, or one that is a stranger's, another's, revoked, at its end or within 30 days of it",
    "start its `zmav up` with `--credentials`; `zmav mesh ca renew NAME`; do not believe what a stranger says",
)

VEHICLES = Topic(
    "vehicles",
    FLEET,
    "who is there; with `--file`, whether all vehicles of the fleet file are",
    "nobody is, or (without `--name`) one of the file's is missing",
    "start `zmav up` beside each autopilot ('zmav sim' makes one), or name a router with `-e`",
    amber="with `--name` of a vehicle, others of the file are missing",
)
SYSIDS = Topic(
    "system ids",
    FLEET,
    "whether two vehicles fly under one MAVLink system id, and whether each has the one of the fleet file",
    "two have the same: a ground station takes them for one; or it is another than the file's",
    "give one another MAV_SYSID (SYSID_THISMAV before ArduPilot 4.7, MAV_SYS_ID of PX4) and restart its autopilot",
)
NAMES = Topic(
    "names",
    FLEET,
    "whether two programs of one kind (agents, planners, routers) go by one name, and names that cannot be",
    "two do",
    "end one of them, or give it another `--name`",
)
VERSIONS = Topic(
    "versions",
    FLEET,
    "zmav and Zenoh on all hosts",
    "they differ: what a newer one says is refused where an older one does not know it",
    "install one version everywhere",
    amber="Zenoh's differ in the patch level only",
)
FIRMWARE = Topic(
    "firmware",
    FLEET,
    "firmware of vehicles of one kind and autopilot",
    "",
    "flash one version, so that they fly alike and parameters mean the same",
    amber="it differs",
)
AGENTS = Topic(
    "agents",
    FLEET,
    "programs that say their status, and in which state they are",
    "one says that it failed, or fell silent while we listened",
    "`zmav agent logs NAME` (or its terminal) says why; start it again",
)
DOCTOR = Topic(
    "doctor",
    FLEET,
    "the examination itself",
    "a part of it was not done in time, or failed",
    "try again; if it stays, look at the hosts one by one with `-e`",
)

TOPICS: tuple[Topic, ...] = tuple(each for each in vars().copy().values() if isinstance(each, Topic))


def explain() -> str:
    """All topics as Markdown tables, by group."""
    lines = []
    for group in GROUPS:
        lines += [f"### {group[0].upper()}{group[1:]}", "", "| line | what is looked at | red, *amber* | what to do |"]
        lines.append("|---|---|---|---|")
        for topic in (each for each in TOPICS if each.group == group):
            when = "; ".join(filter(None, (topic.red, f"*{topic.amber}*" if topic.amber else ""))) or "never"
            lines.append(f"| {topic.name} | {topic.about} | {when} | {topic.todo} |")
        lines.append("")
    return "\n".join(lines)
