"""ArduPilot's side of the MAVLink microservices: what every ArduPilot vehicle does with what it hears."""
