"""ArduPlane: its modes and what they fly by."""
