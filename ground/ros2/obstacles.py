"""What all plans keep clear of, in ROS's words and back: metres east, north, up of the fleet's origin."""

from __future__ import annotations

import time
from typing import Any

from ground.ros2 import convert, frames
from ground.ros2.goals import corners
from ground.ros2.orders import finite, vector
from ground.ros2.types import Types
from zmav import keys
from zmav.errors import BadInput
from zmav.wire import swarm

BOX, CYLINDER, NO_FLY, GEOFENCE, BALL, GONE = 1, 2, 3, 4, 5, 6
"""of zmav_msgs/Obstacle"""
MOST = 2000
"""obstacles of one message"""
OLDEST, AHEAD = 60.0, 5.0
"""s by which a stamp may be before and after now: of another clock (a simulation's), what is said of an obstacle later
would count as overtaken, and a standby planner would have forgotten it when it takes over
"""
KIND = "zmav_msgs/msg/Obstacle"


def told(types: Types, known: swarm.ObstacleMap) -> Any:
    found = [_shown(types, each) for each in known.obstacles[:MOST]]
    stamp = convert.header(types, "", known.t).stamp
    return types.make("zmav_msgs/msg/Obstacles", stamp=stamp, obstacles=found)


def _shown(types: Types, known: swarm.Obstacle) -> Any:
    what, fields = known.what, dict[str, Any]()

    def point(north: float, east: float, down: float = 0.0) -> Any:
        x, y, z = frames.enu((north, east, down))
        return types.make("geometry_msgs/msg/Point", x=x, y=y, z=z)

    if isinstance(what, swarm.Box):
        fields = {"shape": BOX, "corners": [point(*what.low), point(*what.high)]}
    elif isinstance(what, swarm.Cylinder):
        fields = {"shape": CYLINDER, "center": point(*what.center), "radius": what.radius}
    elif isinstance(what, swarm.Ball):
        x, y, z = frames.enu(what.velocity)
        moves = types.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
        fields = {"shape": BALL, "center": point(*what.center), "radius": what.radius, "velocity": moves}
    elif what is not None:
        shape = NO_FLY if isinstance(what, swarm.NoFly) else GEOFENCE
        fields = {"shape": shape, "corners": [point(*corner) for corner in what.polygon]}
    if isinstance(what, swarm.Cylinder | swarm.NoFly | swarm.Geofence):
        fields |= {"floor": what.floor, "ceiling": what.ceiling}
    stamp = convert.header(types, "", known.t).stamp
    return types.make(KIND, name=known.name, stamp=stamp, ttl=known.ttl or 0.0, **({"shape": GONE} | fields))


def given(said: Any) -> list[swarm.Obstacle]:
    """Those of a message; raises :class:`BadInput`, and :class:`~zmav.errors.BadKey` for a name that cannot be."""
    if len(said) > MOST:
        raise BadInput.wrong("obstacles", len(said), f"at most {MOST}")
    return [_one(each) for each in said]


def _one(said: Any) -> swarm.Obstacle:
    name, ttl = keys.check_name(said.name, "obstacle"), finite("ttl", said.ttl)
    now, stamp = time.time(), said.stamp.sec + said.stamp.nanosec / 1e9
    if stamp and not now - OLDEST < stamp < now + AHEAD:
        expected = f"UTC within the last {OLDEST:.0f} s, or zeros for now"
        raise BadInput.wrong("stamp", stamp, expected, f"the stamp of {name} is {stamp:.3f}")
    return swarm.Obstacle(name=name, t=stamp or now, what=_shape(said), ttl=ttl or None)


def _shape(said: Any) -> swarm.Box | swarm.Cylinder | swarm.NoFly | swarm.Geofence | swarm.Ball | None:
    if said.shape == GONE:
        return None
    radius, (north, east, down) = finite("radius", said.radius), vector("center", said.center)
    floor, ceiling = finite("floor", said.floor), finite("ceiling", said.ceiling)
    if said.shape == BOX:
        if len(said.corners) != 2:
            raise BadInput.wrong("corners", len(said.corners), "two, opposite each other")
        low, high = (vector(f"corners[{i}]", each) for i, each in enumerate(said.corners))
        return swarm.Box(low=low, high=high)
    if said.shape == CYLINDER:
        return swarm.Cylinder(center=(north, east), radius=radius, floor=floor, ceiling=ceiling)
    if said.shape == NO_FLY:
        return swarm.NoFly(polygon=corners("corners", said.corners), floor=floor, ceiling=ceiling)
    if said.shape == GEOFENCE:
        return swarm.Geofence(polygon=corners("corners", said.corners), floor=floor, ceiling=ceiling)
    if said.shape == BALL:
        return swarm.Ball(center=(north, east, down), radius=radius, velocity=vector("velocity", said.velocity))
    raise BadInput.wrong("shape", said.shape, "1 to 6: BOX, CYLINDER, NO_FLY, GEOFENCE, BALL, GONE")
