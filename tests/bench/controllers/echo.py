"""A controller whose output says which stick it was made from, and that fails when it is told to: for measuring."""

from __future__ import annotations

import math
import os
import time

import numpy as np

from agents.controllers import Controller, RatesThrust, Reference, State, parameter

RAISES, HANGS, IS_NOT_FINITE = 1, 2, 3
STUCK = 30.0
"""s"""
FULL = 0.9
"""of the yaw stick, at which it fails"""


class Echo(Controller):
    """Gives the sticks back as rates; on a full yaw stick it fails in the way that ``fails`` says."""

    level = "rates"
    gives = "rates"
    fails = parameter(0.0, 0.0, 3.0, "", "0: not, 1: raises, 2: hangs, 3: gives nan")

    def update(self, state: State, reference: Reference) -> RatesThrust:
        begun = time.monotonic()
        rates = np.array(reference.rates)
        if state.sticks[3] > FULL:
            match round(self.fails):
                case 1:
                    raise RuntimeError("as it was told")
                case 2:
                    time.sleep(STUCK)
                case 3:
                    rates[0] = math.nan
        self.signal(begun=begun, process=os.getpid(), roll=float(state.sticks[0]), sticks_t=state.t)
        return RatesThrust(rates, reference.thrust)
