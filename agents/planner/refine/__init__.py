"""From rough ways and times to trajectories that can be flown: smooth, within every limit, clear of each other."""
