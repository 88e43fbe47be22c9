"""How each page's commands are run, and which are not, with the reason.

A page's commands run in their order, in a shell, in a folder and a network of their own (:mod:`tests.docs.stage`).
Programs that run on (:data:`tests.docs.stage.SERVICES`) stay beside those that follow, until the page's end or until a
:class:`Part` begins. **To add a page**: give it its parts in :data:`PARTS`, each with what it stands on and what must
run before, and put what cannot be run here into :data:`NOT_RUN`.
"""

from __future__ import annotations

from typing import NamedTuple

ORIGIN = "--origin -35.363261 149.165230 584.09"
SIM = ("zmav sim --copters 1",)
QUAD = (*SIM, f"zmav up --link tcp:127.0.0.1:5760 --name quad1 {ORIGIN}")
"""one copter and its agent, where every program looks for them"""
UP = "zmav do quad1 arm && zmav do quad1 takeoff alt_rel=10"
TWO = (
    "zmav sim --copters 2",
    QUAD[1],
    f"zmav up --link tcp:127.0.0.1:5770 --name quad2 {ORIGIN} -l tcp/127.0.0.1:7448 -e tcp/127.0.0.1:7447",
)


NEAR = "--origin -35.363666 149.165230 584.09"
"""45 m south of where they stand: so much less is flown to places about 50 m north"""
SWARM = (
    "zmav sim --copters 2 --rovers 1",
    f"zmav up --link tcp:127.0.0.1:5760 --name quad1 {NEAR}",
    f"zmav up --link tcp:127.0.0.1:5770 --name quad2 {NEAR} -l tcp/127.0.0.1:7448 -e tcp/127.0.0.1:7447",
    f"zmav up --link tcp:127.0.0.1:5780 --name rover1 {NEAR} -l tcp/127.0.0.1:7449 -e tcp/127.0.0.1:7447",
    "zmav swarm planner --name ground",
)

GIMBAL = (
    "zmav sim --copters 1 --rovers 1",
    QUAD[1],
    f"zmav up --link tcp:127.0.0.1:5770 --name rover1 {ORIGIN} -l tcp/127.0.0.1:7448 -e tcp/127.0.0.1:7447",
)


class Part(NamedTuple):
    """From a page's first command that begins with ``at`` on: end what runs (if ``fresh``), then run ``before``.

    A fresh part is a test of its own. The programs ``on`` which it stands run on for all parts, of whatever page, that
    stand on the same: each leaves them so that the others can use them. ``alone``: it flies by a controller,
    whose cycles are the real clock's.
    """

    at: str = ""
    on: tuple[str, ...] = ()
    before: tuple[str, ...] = ()
    fresh: bool = True
    alone: bool = False


PARTS: dict[str, tuple[Part, ...]] = {
    "README.md": (
        Part("", QUAD),
        Part("zmav mesh ca init"),
        Part("zmav mesh graph", QUAD),
        Part("zmav param diff", TWO, ("zmav param save quad1 tuned.params", UP)),
        Part("zmav log", before=("zmav do quad1 land",), fresh=False),
        Part("zmav command", before=(UP,), fresh=False),
        Part("zmav swarm planner", SWARM),
        Part("zmav plan"),
        Part("zmav sim --fleet deploy/demos/hexarotor", alone=True),
        Part("zmav gcs", QUAD),
        Part("zenoh", QUAD),
        Part("zmav sim fault", SIM),
    ),
    "docs/agents.md": (Part("", QUAD),),
    "docs/concepts.md": (Part("", QUAD),),
    "docs/credentials.md": (Part("", before=("zmav mesh ca init --fleet alpha",)),),
    "docs/planner.md": (Part("zmav swarm", SWARM),),
    "docs/viewer.md": (Part("", QUAD), Part("zmav view --web --save", QUAD)),
    "docs/http.md": (Part("", QUAD),),
    "docs/planner-files.md": (Part(),),
    "docs/recording.md": (Part("", QUAD),),
    "docs/simulator.md": (Part("zmav sim status", ("zmav sim --copters 2",)), Part("zmav sim fault", SIM)),
    "docs/demos.md": (Part(),),
    "docs/doctor.md": (Part("", QUAD),),
    "docs/gcs.md": (Part("", QUAD),),
    "docs/gimbal.md": (Part("", GIMBAL, ("zmav param set quad1 MNT1_TYPE=1 && zmav do quad1 reboot",)),),
    "docs/terrain.md": (Part("", QUAD, ("mkdir srtm && head -c 2884802 /dev/zero > srtm/S36E149.hgt",)),),
}
"""the pages whose commands are run: of all others each command stands in NOT_RUN"""

NOT_RUN: dict[str, str] = {
    # A regular expression that the whole command matches, or "PAGE: COMMAND": why it is not run here.
    r"(cd zmav && )?make (test|check|demo( ARGS=(\S+|'.*'))?)": (
        "the first is this; the others take minutes: tests/agents/demo"
    ),
    r"(sudo|systemctl|journalctl|git|ssh|scp) .*": "changes this machine, or wants another one: tests/deploy",
    r"docs/page.md: zmav .*": (
        "the gateway and the planner run from docs/http.md and docs/planner.md; the page in a browser and the tiles in "
        "tests/ground/http"
    ),
    r"docs/gallery.md: .*": "minutes of flight, or of planning; each picture is looked at where it is drawn",
    r"docs/gimbal.md: zmav (camera|agent) .*": "wants a camera: tests/agents/camera/test_photos.py",
    r"docs/rtk.md: zmav (rtk|sim fault|echo|get) .*": (
        "wants a caster or a base: tests/ground/rtk, tests/sim/test_corrections.py"
    ),
    r"docs/terrain.md: zmav swarm .*": (
        "wants a planner that knows the ground, and vehicles in the air: tests/agents/planner/live/test_ground_flown.py"
    ),
    r"docs/traffic.md: (zmav (traffic|tak).*|python -m tests.sbs .*)": (
        "wants a receiver or a TAK server, or serves until it is stopped: tests/ground/traffic, tests/ground/tak"
    ),
    r"docs/other-languages.md: .*": "beside what serves until it is stopped: tests/ground/test_other_languages.py",
    r"zmav sim .*--up": "it runs until it is stopped: tests/cli/test_sim.py",
    r"docs/ros2.md: .*": "wants ROS 2, or the SDK: tests/ground/ros2, tests/ground/test_examples.py",
    r"docs/camera.md: zmav http": "it serves until it is stopped: tests/ground/http/test_cameras.py",
    r"docs/planner-goals.md: zmav .*": (
        "searches and surveys want vehicles in the air and a planner: tests/agents/planner/goals/test_survey.py"
    ),
    r"docs/recording.md: zmav http --replay .*": "it serves until it is stopped: tests/ground/http/test_replay.py",
    r"docs/http.md: (curl .*/mission/upload.*|zmav record --orders .*)": (
        "they want a file: tests/ground/http/test_missions.py, tests/ground/record/test_orders.py"
    ),
    r"docs/(install|vehicle-setup).md: .*": (
        "on the vehicle, beside a real autopilot: tests/deploy, tests/docs/test_vehicle_setup.py"
    ),
    r"docs/quickstart.md: (zmav .*quad[23].*|zmav mesh (ca|config|graph).*|zmav swarm .*|zmav param set 'quad\*' .*"
    r"|zmav (ls|doctor|gcs|top|record --out flights|do .*|goto quad1 --to .*|echo .*ATTITUDE.*|demo --stay))": (
        "with three vehicles, in the reader's order: README.md has them run; tests/agents/demo"
    ),
    r"docs/quickstart.md: \. \.venv/bin/activate": "changes the reader's shell: all here runs in that environment",
    r"docs/matlab.md: zmav (sim|up|http)\b.*": "README.md and docs/http.md have them run; tests/ground/matlab",
    r"docs/concepts.md: zmav (ls|echo 'quad\*/ATTITUDE' -n 1)": "README.md has them run",
    r"docs/(gcs.md: zmav gcs|mesh.md: zmav mesh config .*|planner.md: zmav swarm list)": ("README.md has them run"),
    r"docs/planner-files.md: zmav plan scene.json --picture plan.png": "tests/agents/planner/test_plan_cli.py",
    r"zmav demo (?!--list$).*": "minutes of flight: tests/agents/demo",
    r"zmav doctor( --file .*| --link .*)": "looks at a vehicle's own computer: tests/cli/test_doctor_fleet.py",
    r"zmav hil .*": "asks a person, and wants an autopilot: tests/agents/hil",
    r"make conformance.*": "flies for minutes: tests/conformance, which 'make test' runs on the simulated autopilots",
    r"(sudo )?zmav lab .*": "needs root and a network of many hosts: tests/mesh/lab",
    r"sudo python tests/bench/.*|python tests/bench/.*": "a measurement of many minutes",
    r"zmav sim (--(ardupilot|px4) .*|.* --px4 ~.*|--copters 10 .*|--speed max.*)": (
        "real flight stacks, or as many vehicles as fill the machine: tests/sim"
    ),
    r"zmav sim --hil .*|zmav camera .*/dev/.*|.* --serial /dev/.*": "needs a device: tests/hil, tests/agents/camera",
    r"pip install .*": "a network to the package registries; what it names is looked up among its extras",
    r"zmav view": "opens a window, or wants one elsewhere: tests/ground/view",
    r"zmav mesh bench (?!quad1 ground$).*|zmav mesh bench quad1 ground": "wants two hosts: tests/mesh/bench",
    r"zmav (up|router) --file fleet.toml .*": "wants a fleet's radios: tests/mesh/test_running.py",
    r"docs/.*\.md: zmav swarm (takeoff|formation|planner) .*|zmav swarm cancel g1|zmav router &": (
        "README.md has them run; others are about a goal of the reader's: tests/agents/planner/live"
    ),
    r"zmav agent (run|do) (follower|helipad) .*|zmav agent do follower .*": (
        "wants a camera above a rover: 'zmav demo follow' has one; tests/agents/follower"
    ),
    r"docs/(?!agents).*\.md: zmav agent .*(hex1|rover1|quad1).*|docs/controllers.md: zmav (do|up|sim) .*": (
        "README.md has them run; cycles by the clock want a machine for themselves: tests/agents/controllers"
    ),
    r"zmav video .*|docs/video.md: zmav .*": "wants a camera, or runs until it is stopped: tests/agents/camera",
    r"zmav camera .*|docs/camera.md: zmav agent list": "wants a camera, or a video: tests/agents/camera",
    r"zmav sim --copters 1 --rovers 1 --pad .*": "renders pictures, a core for itself: tests/sim/camera",
    r"zmav sim --fleet fleet.toml": "the fleet file is the reader's: tests/sim/test_fleetfile.py",
    r"zmav (ls|do|doctor|mesh ca roster) .*-e quic/10\..*": (
        "addresses of the example's network: tests/mesh/credentials"
    ),
    r"zmav mesh ca init --fleet alpha --passphrase": "asks for a passphrase at a terminal: tests/mesh/credentials",
    r"zmav doctor --credentials DIR": "DIR is the reader's: tests/cli/test_doctor.py",
    r"zmav gcs --udp 192.*": "an address that is not here: tests/ground/gcs",
    r"zmav replay (recordings|quad1.*)": (
        "README.md has one run; in real time it ends with the recorder: tests/ground/record/test_replay.py"
    ),
    r"zmav record --out /data .*": "a disk that is not here: tests/ground/record",
    r"zmav get '?\S*history/.*": "wants a recorder by that name with a past: tests/ground/record",
    r"zmav sim --endpoint pty:.*|zmav up --link /tmp/quad1.*": (
        "terminals outside of the test's folder: tests/sim/test_endpoints.py"
    ),
    r"python -m tests.bench.scale .*": "minutes of many cores: tests/bench/scale",
    r"zmav plan scenes/.*": "minutes of planning: tests/agents/planner/test_plan_cli.py",
}

COMING = frozenset[str]()
"""verbs that are being written and may be named before they are there"""
