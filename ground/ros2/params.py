"""The autopilot's parameters as those of a node of ROS, ``/{vehicle}/param``, as MAVROS 2 has them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ground.ros2.node import RosNode
from ground.ros2.orders import finite, serve_order
from ground.ros2.steering import Log, Steering
from zmav import wire
from zmav.errors import BadInput, ZmavError
from zmav.vehicle import Vehicle

NOT_SET, BOOL, INTEGER, DOUBLE = 0, 1, 2, 3
"""of rcl_interfaces/ParameterType"""
PACKAGE = "rcl_interfaces"
MOST = 2000
"""parameters of one request"""
ONE_BY_ONE = "an autopilot sets one parameter at a time: use set_parameters"


class Parameters:
    """The services. Lives on the event loop; reads come from the cache on the vehicle."""

    def __init__(self, node: RosNode, vehicle: Vehicle, steering: Steering, log: Log) -> None:
        self._vehicle, self._steering = vehicle, steering
        self._make = node.ros.types.make
        for name, answer in (
            ("GetParameters", self._get),
            ("GetParameterTypes", self._types),
            ("SetParameters", self._set),
            ("SetParametersAtomically", self._set_atomically),
            ("ListParameters", self._list),
            ("DescribeParameters", self._describe),
        ):
            service = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in name)
            node.serve(f"param/{service[1:]}", f"{PACKAGE}/srv/{name}", answer)
        serve_order(node, "param/pull", "mavros_msgs/srv/ParamPull", self._pull, log)
        serve_order(node, "param/set", "mavros_msgs/srv/ParamSetV2", self._set_one, log)

    async def _known(self) -> dict[str, wire.Param]:
        return {param.name: param for param in (await self._vehicle.params.list()).params}

    async def _get(self, request: Any, gid: bytes) -> Any:
        known = await self._known()
        values = [self._value(known.get(name)) for name in few(request.names)]
        return self._make(f"{PACKAGE}/srv/GetParameters_Response", values=values)

    async def _types(self, request: Any, gid: bytes) -> Any:
        known = await self._known()
        types = np.array([kind(known.get(name)) for name in few(request.names)], dtype=np.uint8)
        return self._make(f"{PACKAGE}/srv/GetParameterTypes_Response", types=types)

    async def _describe(self, request: Any, gid: bytes) -> Any:
        known = await self._known()
        found = [
            self._make(f"{PACKAGE}/msg/ParameterDescriptor", name=name, type=kind(known.get(name)))
            for name in few(request.names)
        ]
        return self._make(f"{PACKAGE}/srv/DescribeParameters_Response", descriptors=found)

    async def _list(self, request: Any, gid: bytes) -> Any:
        """A prefix is a name up to a dot, as in ROS: an autopilot's names have none."""
        prefixes = few(request.prefixes)
        names = [
            name
            for name in await self._known()
            if not prefixes or any(name == each or name.startswith(f"{each}.") for each in prefixes)
        ]
        result = self._make(f"{PACKAGE}/msg/ListParametersResult", names=names)
        return self._make(f"{PACKAGE}/srv/ListParameters_Response", result=result)

    async def _set(self, request: Any, gid: bytes) -> Any:
        results = [await self._change(each.name, each.value, gid) for each in few(request.parameters)]
        return self._make(f"{PACKAGE}/srv/SetParameters_Response", results=results)

    async def _set_atomically(self, request: Any, gid: bytes) -> Any:
        given = few(request.parameters)
        if len(given) == 1:
            result = await self._change(given[0].name, given[0].value, gid)
        else:
            result = self._make(f"{PACKAGE}/msg/SetParametersResult", successful=not given, reason=ONE_BY_ONE)
        return self._make(f"{PACKAGE}/srv/SetParametersAtomically_Response", result=result)

    async def _change(self, name: str, value: Any, gid: bytes) -> Any:
        try:
            await self._order(name, value, gid)
        except ZmavError as e:
            return self._make(f"{PACKAGE}/msg/SetParametersResult", successful=False, reason=str(e))
        return self._make(f"{PACKAGE}/msg/SetParametersResult", successful=True)

    async def _order(self, name: str, value: Any, gid: bytes) -> None:
        self._steering.check()
        numbers: dict[int, float | int] = {INTEGER: value.integer_value, DOUBLE: value.double_value}
        if value.type not in numbers:
            raise BadInput.wrong("value", f"of type {value.type}", "an integer or a double", f"{name} is a number")
        given = numbers[value.type]
        if isinstance(given, float):
            given = finite(name, given)
        args = wire.ParamSet(name=name, value=given, lease=self._steering.token(gid))
        await self._vehicle.order("param_set", args)

    async def _pull(self, request: Any, gid: bytes) -> dict[str, Any]:
        """Read from the vehicle's cache; with force_pull from the autopilot, which is an order."""
        params = self._vehicle.params
        if request.force_pull:
            self._steering.check()
        table = await (params.refresh() if request.force_pull else params.list())
        return {"param_received": len(table.params)}

    async def _set_one(self, request: Any, gid: bytes) -> dict[str, Any]:
        """What it is then comes back, as MAVROS answers."""
        await self._order(request.param_id, request.value, gid)
        try:
            return {"value": self._value(await self._vehicle.params.get(request.param_id))}
        except ZmavError:  # it is set all the same
            return {"value": request.value}

    def _value(self, param: wire.Param | None) -> Any:
        what = kind(param)
        if param is None or what == NOT_SET:
            return self._make(f"{PACKAGE}/msg/ParameterValue")
        field = "integer_value" if what == INTEGER else "double_value"
        return self._make(f"{PACKAGE}/msg/ParameterValue", type=what, **{field: param.value})


def kind(param: wire.Param | None) -> int:
    """Of rcl_interfaces/ParameterType; a parameter that there is not, and one that is no number, is not set."""
    if param is None or param.value is None:
        return NOT_SET
    return INTEGER if isinstance(param.value, int) else DOUBLE


def few(given: Any) -> list[Any]:
    if len(given) > MOST:
        raise BadInput.wrong("names", len(given), f"at most {MOST}")
    return list(given)
