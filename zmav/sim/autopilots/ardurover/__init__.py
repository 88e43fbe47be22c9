"""ArduRover's rules."""
