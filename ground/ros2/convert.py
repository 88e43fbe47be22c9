"""What the vehicle says, as messages of ROS: each function makes one, or None where what it needs was not heard.

Units are ROS's: m, m/s, rad, V, A, Pa; frames are of REP-103 and REP-105: ``{fleet}`` (east, north, up about the
fleet's origin) and ``{vehicle}/base_link`` (forward, left, up).
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ground.ros2 import frames
from ground.ros2.types import Types
from zmav import geo, wire
from zmav.services.status.events import SEVERITIES

G = 9.80665
NAN = math.nan
LATEST = 2.0**31 - 1.0
"""s since 1970: ROS's seconds have 32 bits"""
DISCHARGING, POWER_UNKNOWN = 2, 0
"""of sensor_msgs/BatteryState"""
UNKNOWN_FIX, NO_FIX, FIX, SBAS_FIX, GBAS_FIX, GPS = -2, -1, 0, 1, 2, 1
"""of sensor_msgs/NavSatStatus"""
APPROXIMATED = 2
"""of sensor_msgs/NavSatFix: COVARIANCE_TYPE_DIAGONAL_KNOWN"""
FIXES = {4: SBAS_FIX, 5: GBAS_FIX, 6: GBAS_FIX}
"""of GPS_FIX_TYPE: DGPS, RTK float, RTK fixed"""
_NAMED = ("UNINIT", "BOOT", "CALIBRATING", "STANDBY", "ACTIVE", "CRITICAL", "EMERGENCY", "POWEROFF")
MAV_STATES = (*_NAMED, "FLIGHT_TERMINATION")
GUIDED = ("GUIDED", "OFFBOARD")
PX4_MODES = {
    "READY": "AUTO.READY",
    "TAKEOFF": "AUTO.TAKEOFF",
    "HOLD": "AUTO.LOITER",
    "MISSION": "AUTO.MISSION",
    "RTL": "AUTO.RTL",
    "LAND": "AUTO.LAND",
    "FOLLOW": "AUTO.FOLLOW_TARGET",
    "PRECLAND": "AUTO.PRECLAND",
}
"""PX4's modes as zmav names them, and MAVROS"""
IMU_OF = {"ardupilot": "RAW_IMU", "px4": "HIGHRES_IMU"}
"""the message with accelerations that each autopilot sends by itself"""


@dataclass
class View:
    """What is known of one vehicle. ``last``: the fields of the newest message by name, where it is not old."""

    types: Types
    fleet: str
    name: str
    """as in frames"""
    state: wire.VehicleState | None
    last: Mapping[str, Mapping[str, Any]]
    t: float
    """UTC s of what is said"""

    @property
    def base(self) -> str:
        return f"{self.name}/base_link"

    def header(self, frame: str) -> Any:
        return header(self.types, frame, self.t)

    def orientation(self) -> frames.Quaternion | None:
        """None where none was heard, or what was is no number."""
        attitude = self.last.get("ATTITUDE")
        if attitude is None or not all(math.isfinite(attitude[angle]) for angle in ("roll", "pitch", "yaw")):
            return None
        return frames.orientation(attitude["roll"], attitude["pitch"], attitude["yaw"])

    def place(self) -> tuple[wire.Vector, wire.Vector] | None:
        """Position (m) and velocity (m/s) in the fleet's frame, east, north, up; None where no origin was declared."""
        fields, state = self.last.get("GLOBAL_POSITION_INT"), self.state
        if fields is None or state is None or state.local is None or state.position is None:
            return None
        ned = geo.in_fleet_frame(state.position, state.local, fields)
        return frames.enu(ned), frames.enu((fields["vx"] / 100.0, fields["vy"] / 100.0, fields["vz"] / 100.0))

    def vector(self, at: wire.Vector, kind: str = "Vector3") -> Any:
        return self.types.make(f"geometry_msgs/msg/{kind}", x=at[0], y=at[1], z=at[2])

    def quaternion(self, q: frames.Quaternion) -> Any:
        return self.types.make("geometry_msgs/msg/Quaternion", x=q[0], y=q[1], z=q[2], w=q[3])

    def pose(self, at: wire.Vector, q: frames.Quaternion) -> Any:
        point = self.vector(at, "Point")
        return self.types.make("geometry_msgs/msg/Pose", position=point, orientation=self.quaternion(q))

    def twist(self, linear: wire.Vector, angular: wire.Vector) -> Any:
        return self.types.make("geometry_msgs/msg/Twist", linear=self.vector(linear), angular=self.vector(angular))


def header(types: Types, frame: str, t: float) -> Any:
    """Of what is said of ``t``, UTC s."""
    t = min(max(t, 0.0), LATEST)
    stamp = types.make("builtin_interfaces/msg/Time", sec=int(t), nanosec=int(t % 1.0 * 1e9))
    return types.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def raw_fix(view: View) -> Any:
    """What the receiver says. Its altitude is above the ellipsoid; NaN where the receiver does not say that."""
    gps = view.last.get("GPS_RAW_INT")
    if gps is None:
        return None
    return _fix(view, gps["lat"], gps["lon"], gps["alt_ellipsoid"] / 1e3 if gps["alt_ellipsoid"] else NAN)


def fix(view: View) -> Any:
    """Where the autopilot's estimate is. The height of the geoid is the receiver's; NaN where that does not say it."""
    fields, gps = view.last.get("GLOBAL_POSITION_INT"), view.last.get("GPS_RAW_INT")
    if fields is None:
        return None
    geoid = (gps["alt_ellipsoid"] - gps["alt"]) / 1e3 if gps is not None and gps["alt_ellipsoid"] else NAN
    return _fix(view, fields["lat"], fields["lon"], fields["alt"] / 1e3 + geoid)


def _fix(view: View, lat: int, lon: int, altitude: float) -> Any:
    gps = view.last.get("GPS_RAW_INT")
    status, across, up = UNKNOWN_FIX, 0.0, 0.0
    if gps is not None:
        across, up = gps["h_acc"] / 1e3, gps["v_acc"] / 1e3
        status = FIXES.get(gps["fix_type"], FIX) if gps["fix_type"] >= 3 else NO_FIX
    return view.types.make(
        "sensor_msgs/msg/NavSatFix",
        header=view.header(view.base),
        status=view.types.make("sensor_msgs/msg/NavSatStatus", status=status, service=GPS),
        latitude=lat / 1e7,
        longitude=lon / 1e7,
        altitude=altitude,
        position_covariance=np.diag([across**2, across**2, up**2]).ravel(),
        position_covariance_type=APPROXIMATED if across and up else 0,
    )


def rel_alt(view: View) -> Any:
    fields = view.last.get("GLOBAL_POSITION_INT")
    return fields and view.types.make("std_msgs/msg/Float64", data=fields["relative_alt"] / 1e3)


def compass(view: View) -> Any:
    """Degrees from north, clockwise: MAVROS's, which is none of REP-103."""
    fields = view.last.get("GLOBAL_POSITION_INT")
    if fields is None or fields["hdg"] == 0xFFFF:
        return None
    return view.types.make("std_msgs/msg/Float64", data=fields["hdg"] / 100.0)


def imu(view: View) -> Any:
    """Orientation and rates as estimated; what accelerates it as measured, where that message comes."""
    attitude, q = view.last.get("ATTITUDE"), view.orientation()
    if attitude is None or q is None:
        return None
    rates = frames.flu((attitude["rollspeed"], attitude["pitchspeed"], attitude["yawspeed"]))
    raw, fine, unknown = view.last.get("RAW_IMU"), view.last.get("HIGHRES_IMU"), np.zeros(9)
    if fine is not None:
        felt = frames.flu((fine["xacc"], fine["yacc"], fine["zacc"]))
    elif raw is not None:  # of ArduPilot, in thousandths of g
        felt = frames.flu((raw["xacc"] * G / 1e3, raw["yacc"] * G / 1e3, raw["zacc"] * G / 1e3))
    else:
        felt = (0.0, 0.0, 0.0)
        unknown[0] = -1.0  # as sensor_msgs/Imu says that there is none
    return view.types.make(
        "sensor_msgs/msg/Imu",
        header=view.header(view.base),
        orientation=view.quaternion(q),
        orientation_covariance=np.zeros(9),
        angular_velocity=view.vector(rates),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=view.vector(felt),
        linear_acceleration_covariance=unknown,
    )


def battery(view: View) -> Any:
    fields = view.last.get("SYS_STATUS")
    if fields is None:
        return None
    volts = fields["voltage_battery"] / 1e3 if fields["voltage_battery"] not in (0, 0xFFFF) else NAN
    amperes = -fields["current_battery"] / 100.0 if fields["current_battery"] >= 0 else NAN
    return view.types.make(
        "sensor_msgs/msg/BatteryState",
        header=view.header(view.base),
        voltage=volts,
        temperature=NAN,
        current=amperes,  # negative while it discharges
        charge=NAN,
        capacity=NAN,
        design_capacity=NAN,
        percentage=fields["battery_remaining"] / 100.0 if fields["battery_remaining"] >= 0 else NAN,
        power_supply_status=DISCHARGING if amperes < 0 else POWER_UNKNOWN,
        present=not math.isnan(volts),
    )


def pose(view: View) -> Any:
    place, q = view.place(), view.orientation()
    if place is None or q is None:
        return None
    made = view.pose(place[0], q)
    return view.types.make("geometry_msgs/msg/PoseStamped", header=view.header(view.fleet), pose=made)


def _twists(view: View) -> tuple[wire.Vector, wire.Vector, wire.Vector] | None:
    """Velocity in the world and in the body, and the rates of the body."""
    place, q, attitude = view.place(), view.orientation(), view.last.get("ATTITUDE")
    if place is None or q is None or attitude is None:
        return None
    rates = frames.flu((attitude["rollspeed"], attitude["pitchspeed"], attitude["yawspeed"]))
    return place[1], frames.in_body(place[1], q), rates


def velocity_local(view: View) -> Any:
    """Along east, north, up; so are the rates, as MAVROS has them."""
    found, q = _twists(view), view.orientation()
    if found is None or q is None:
        return None
    return _twist_stamped(view, view.fleet, found[0], frames.in_world(found[2], q))


def velocity_body(view: View) -> Any:
    found = _twists(view)
    return found and _twist_stamped(view, view.base, found[1], found[2])


def _twist_stamped(view: View, frame: str, linear: wire.Vector, angular: wire.Vector) -> Any:
    twist = view.twist(linear, angular)
    return view.types.make("geometry_msgs/msg/TwistStamped", header=view.header(frame), twist=twist)


def odometry(view: View) -> Any:
    """The pose in the fleet's frame, the twist in the body's. Covariances are not known: zero."""
    place, q, found = view.place(), view.orientation(), _twists(view)
    if place is None or q is None or found is None:
        return None
    at, moves = view.pose(place[0], q), view.twist(found[1], found[2])
    return view.types.make(
        "nav_msgs/msg/Odometry",
        header=view.header(view.fleet),
        child_frame_id=view.base,
        pose=view.types.make("geometry_msgs/msg/PoseWithCovariance", pose=at, covariance=np.zeros(36)),
        twist=view.types.make("geometry_msgs/msg/TwistWithCovariance", twist=moves, covariance=np.zeros(36)),
    )


def transform(view: View) -> Any:
    place, q = view.place(), view.orientation()
    if place is None or q is None:
        return None
    moved = view.types.make(
        "geometry_msgs/msg/Transform", translation=view.vector(place[0]), rotation=view.quaternion(q)
    )
    one = view.types.make(
        "geometry_msgs/msg/TransformStamped",
        header=view.header(view.fleet),
        child_frame_id=view.base,
        transform=moved,
    )
    return view.types.make("tf2_msgs/msg/TFMessage", transforms=[one])


def state(view: View) -> Any:
    said = view.state
    if said is None:
        return None
    mode = said.mode or ""
    return view.types.make(
        "mavros_msgs/msg/State",
        header=view.header(""),
        connected=said.connected,
        armed=bool(said.armed),
        guided=mode in GUIDED,
        mode=PX4_MODES.get(mode, mode) if said.autopilot == "px4" else mode,
        system_status=MAV_STATES.index(said.status) if said.status in MAV_STATES else 0,
    )


def extended_state(view: View) -> Any:
    said = view.state
    if said is None:
        return None
    landed = {True: 1, False: 2}.get(said.landed, 0) if said.landed is not None else 0
    return view.types.make("mavros_msgs/msg/ExtendedState", header=view.header(""), landed_state=landed)


def status_text(types: Types, event: wire.Event) -> Any:
    severity, said = SEVERITIES.index(event.severity), header(types, "", event.t)
    return types.make("mavros_msgs/msg/StatusText", header=said, severity=severity, text=event.text)


def now(types: Types) -> Any:
    return header(types, "", time.time()).stamp
