"""What an ArduPilot reports: one function per message, with ArduPilot's signs, units and fill-ins.

Each takes the vehicle's :class:`~zmav.sim.protocol.ardupilot.node.MavNode` and gives the message's fields, or None
where the vehicle has nothing to say yet. Field conventions follow recordings of ArduPilot SITL; messages:
https://mavlink.io/en/messages/common.html
"""
