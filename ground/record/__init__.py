"""``zmav record``: record the fleet, and answer questions of what was."""
