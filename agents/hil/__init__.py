"""From the simulator to the vehicle with one fleet file: SIL, a bench with the real autopilot (HIL), and a last look
before it flies. docs/hil.md is the guide.
"""
