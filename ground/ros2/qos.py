"""Quality of service as ``rmw_zenoh`` writes it in a token: ``rel:dur:hist,depth:deadline:lifespan:liveliness``.

What is a default is left blank: ``::,10:,:,:,,``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from zmav.errors import BadInput

_FORM = re.compile(r"(\d?):(\d?):(\d?),(\d{0,9}):[\d,]*:[\d,]*:[\d,]*\Z", re.ASCII)


@dataclass(frozen=True)
class RosQos:
    """What matters here of a profile; deadlines and lifespans are never set by us, and not read."""

    reliable: bool = True
    transient_local: bool = False
    """who comes late is given the last ``depth`` messages"""
    depth: int = 10

    def encode(self) -> str:
        return f"{'' if self.reliable else 2}:{1 if self.transient_local else ''}:,{self.depth}:,:,:,,"

    @classmethod
    def decode(cls, text: str) -> RosQos:
        """Raises :class:`BadInput`."""
        found = _FORM.match(text)
        if found is None:
            raise BadInput(f"no QoS: {text[:80]!r}", field="qos", value=text[:80], expected="::,10:,:,:,,")
        reliability, durability, _, depth = found.groups()
        return cls(reliability != "2", durability == "1", int(depth or 10))


RELIABLE = RosQos()
SENSOR = RosQos(reliable=False, depth=5)
"""rclpy's qos_profile_sensor_data, as MAVROS has it"""
LATCHED = RosQos(transient_local=True)
