"""The way home for everybody: planned while a fleet flies, stored on each vehicle, flown by each alone."""
