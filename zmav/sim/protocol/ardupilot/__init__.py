"""The MAVLink face of an ArduPilot."""
