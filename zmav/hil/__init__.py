"""The simulator for other people's autopilots: our physics and sensors under a real flight stack, in software (SIL) or
on its own hardware (HIL).
"""
