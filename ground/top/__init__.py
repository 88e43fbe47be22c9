"""``zmav top``: watch the fleet in the terminal."""
