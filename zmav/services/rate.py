"""The floor: messages that always flow, asked for until they do."""

from __future__ import annotations

from zmav.services.identity import Identity
from zmav.services.port import Port

SET_MESSAGE_INTERVAL = 511


class Floor:
    """Keeps an autopilot sending what a VehicleState is made of; a rebooted one is asked again. On the event loop."""

    def __init__(self, port: Port, identity: Identity) -> None:
        self._port, self._identity = port, identity

    def tick(self) -> None:
        """Ask for what does not flow; without an acknowledgement, since the next tick sees whether it came."""
        source, autopilot = self._identity.source, self._identity.autopilot
        if source is None or autopilot is None or not self._identity.connected:
            return
        for name, hz in autopilot.floor.items():
            heard = self._port.latest(name, source)
            if heard is None or heard.age > 3.0 / hz:
                self._port.send(
                    "COMMAND_LONG",
                    target_system=source[0],
                    target_component=source[1],
                    command=SET_MESSAGE_INTERVAL,
                    param1=float(self._port.dialect.message(name).id),
                    param2=1e6 / hz,
                )
