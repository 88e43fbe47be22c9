"""What one vehicle declares and says, without its autopilot: so that a thousand fit on one machine.

Counted on a simulated copter behind ``zmav up``: ``test_footprint.py`` holds the two side by side, and fails when what
``zmav up`` declares is no longer what stands here.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import msgspec
import zenoh
import zenoh.ext

from zmav import keys, wire

STREAMED: dict[str, tuple[float, int]] = {
    "GLOBAL_POSITION_INT": (10.0, 27),
    "ATTITUDE": (10.0, 14),
    "SYS_STATUS": (2.0, 43),
    "GPS_RAW_INT": (2.0, 52),
    "EKF_STATUS_REPORT": (2.0, 34),
    "EXTENDED_SYS_STATE": (2.0, 14),
    "TIMESYNC": (1.0, 26),
    "HEARTBEAT": (1.0, 21),
    "MISSION_CURRENT": (1.0, 17),
}
"""message -> Hz and bytes of a frame"""
SAID_SELDOM = (
    "COMMAND_ACK",
    "AUTOPILOT_VERSION",
    "SYSTEM_TIME",
    "STATUSTEXT",
    "PARAM_VALUE",
    "MESSAGE_INTERVAL",
    "GPS_GLOBAL_ORIGIN",
    "HOME_POSITION",
)
"""a publisher is declared for them, too"""
TICK_HZ = 10
STATE_HZ = 5
_WHO: dict[str, object] = {"sys": 1, "comp": 1}


class Copter:
    """One vehicle's declarations in ``session``, and its words whenever :meth:`tick` is called, ``TICK_HZ`` a second.

    ``number`` tells vehicles apart; system ids repeat after 250, which a real fleet would not be allowed.
    """

    def __init__(self, session: zenoh.Session, fleet: str, name: str, number: int) -> None:
        self._fleet, self._name, self._number = fleet, name, number
        zid = str(session.info.zid())
        self._state = ready_copter(fleet, name, zid, number)
        self._link = msgspec.structs.replace(_LINK)
        declare = session.declare_publisher
        self._streams = [
            (declare(keys.RX.key(fleet, name, **_WHO, msg=msg), **keys.RX.publishing()), round(TICK_HZ / hz), size)
            for msg, (hz, size) in STREAMED.items()
        ]
        self._seldom = [
            declare(keys.RX.key(fleet, name, **_WHO, msg=msg), **keys.RX.publishing()) for msg in SAID_SELDOM
        ]
        self._readers = declare(keys.RX.key(fleet, name, sys="*", comp="*", msg="*"))
        self._states = declare(keys.STATE.key(fleet, name), **keys.STATE.publishing())
        link = keys.LINK.key(fleet, name, link="autopilot")
        self._links = declare(link, **keys.LINK.publishing())
        self._held = [*self._listen(session), *self._answers(session), self._events(session)]
        alive = keys.ALIVE.key(
            fleet,
            name,
            role=keys.VEHICLE,
            sys=self._state.sysid,
            autopilot="ardupilot",
            uid=f"{number:016x}",
            instance=zid,
        )
        self._held.append(session.liveliness().declare_token(alive))
        self.heard: list[str] = []
        """keys of setpoints and frames that came for it"""

    def _listen(self, session: zenoh.Session) -> list[Any]:
        fleet, name = self._fleet, self._name

        def take(sample: zenoh.Sample) -> None:
            self.heard.append(str(sample.key_expr))

        tokens = (
            keys.WANT.key(fleet, name, msg="*", hz="*", instance="*"),
            keys.HOLDER.key(fleet, name, holder="*", instance="*"),
        )
        return [
            session.declare_subscriber(keys.SETPOINT.key(fleet, name, agent="*"), take),
            session.declare_subscriber(keys.TX.key(fleet, name, sys="*", comp="*", msg="*"), take),
            session.declare_subscriber(keys.EVENT.key(fleet, name), lambda sample: None),
            session.declare_subscriber(keys.AGENT_STATUS.key(fleet, name, agent="photos-$*"), lambda sample: None),
            *(session.liveliness().declare_subscriber(key, lambda sample: None, history=True) for key in tokens),
        ]

    def _answers(self, session: zenoh.Session) -> list[Any]:
        fleet, name = self._fleet, self._name
        silent = (
            keys.MSG.key(fleet, name, msg="*"),
            keys.BODY.key(fleet, name),
            keys.HOST.key(fleet, name),
            keys.PARAMS.key(fleet, name),
            keys.PARAM.key(fleet, name, param="*"),
            keys.MISSION.key(fleet, name, kind="*"),
            keys.RATES.key(fleet, name),
            keys.TERRAIN.key(fleet, name),
            keys.SCHEMA.key(fleet, name, schema="*"),
            keys.FILE.key(fleet, name, file="*"),
            keys.FILE_CHUNK.key(fleet, name, file="*", offset="*"),
        )
        state, do = keys.STATE.key(fleet, name), keys.DO.key(fleet, name, verb="*")
        link = keys.LINK.key(fleet, name, link="autopilot")
        return [
            *(session.declare_queryable(key, _drop) for key in silent),
            session.declare_queryable(state, _replying(state, lambda: wire.encode(self.state()))),
            session.declare_queryable(link, _replying(link, lambda: wire.encode(self._link))),
            session.declare_queryable(do, _replying("", lambda: wire.encode(_DONE))),
        ]

    def _events(self, session: zenoh.Session) -> Any:
        ext = zenoh.ext
        return ext.declare_advanced_publisher(
            session,
            keys.EVENT.key(self._fleet, self._name),
            encoding=keys.EVENT.encoding,
            **keys.EVENT.qos.options(),
            cache=ext.CacheConfig(max_samples=200),
            publisher_detection=True,
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=1.0),
        )

    def state(self) -> wire.VehicleState:
        """As it is now: parked at its place."""
        self._state.t = time.time()
        return self._state

    def tick(self, beat: int) -> None:
        """Publish what is due; vehicles take turns, so that a fleet does not speak in one burst."""
        beat += self._number
        for publisher, every, size in self._streams:
            if beat % every == 0:
                publisher.put(os.urandom(size))
        if beat % (TICK_HZ // STATE_HZ) == 0:
            self._states.put(wire.encode(self.state()))
        if beat % TICK_HZ == 0:
            self._link.t = time.time()
            self._links.put(wire.encode(self._link))


def _drop(query: zenoh.Query) -> None:
    query.drop()


def _replying(key: str, body: Callable[[], bytes]) -> Callable[[zenoh.Query], None]:
    def answer(query: zenoh.Query) -> None:
        with query:
            asked = str(query.key_expr)
            if key or "*" not in asked:  # a wildcard is no order
                query.reply(key or asked, body(), encoding=keys.JSON)

    return answer


_DONE = wire.Outcome(verb="ping", status="done", took=0.0, result={"t": 0.0})
_LINK = wire.LinkQuality(
    t=0.0,
    name="autopilot",
    url="udpin:127.0.0.1:14550",
    state="up",
    age=0.01,
    rx_rate=32.1,
    rx_bytes_rate=812.3,
    loss=0.0,
    rtt=0.0012,
    rx_frames=4823,
    rx_bytes=122_034,
    tx_frames=312,
    opens=1,
)


def ready_copter(fleet: str, name: str, zid: str, number: int) -> wire.VehicleState:
    """A copter ready to fly, with every part that one of ``zmav up`` has."""
    north, east = 20.0 * (number // 32), 20.0 * (number % 32)
    ages = dict.fromkeys(("position", "attitude", "battery", "gps"), 0.04183530807495117)
    return wire.VehicleState(
        t=0.0,
        fleet=fleet,
        name=name,
        instance=zid,
        connected=True,
        sysid=1 + number % 250,
        compid=1,
        uid=f"{number:016x}",
        autopilot="ardupilot",
        kind="copter",
        firmware="4.5.7",
        mode="GUIDED",
        armed=False,
        status="STANDBY",
        landed=True,
        ready=True,
        link="up",
        position=wire.GlobalPosition(
            lat_deg=-35.363261 + north / 111_194.9, lon_deg=149.16523 + east / 90_680.0, alt_amsl=584.09, alt_rel=0.012
        ),
        local=(north, east, -0.012),
        velocity=(0.01, -0.01, 0.0),
        attitude=wire.Attitude(roll=0.0012345678, pitch=-0.00234567, yaw=1.5707963268),
        battery=wire.Battery(voltage=12.587, current=0.51, remaining=0.99),
        gps=wire.Gps(fix="RTK_FIXED", satellites=10, hdop=1.21),
        clock=wire.ClockInfo(boot_t=1_790_000_000.123456, error_s=0.000123456, drift_ppm=0.0123),
        ages=ages,
    )
