"""Ways and times for all vehicles together in tight places: a discrete search that waits, yields and pushes."""

from agents.planner.solve.spacetime.deconflict import find, repair

__all__ = ["find", "repair"]
