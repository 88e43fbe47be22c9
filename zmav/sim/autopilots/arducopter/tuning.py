"""ArduCopter's controller parameters, and which gain of the simulated loops each one scales.

The gains at the parameters' defaults are those that fly as a real one was measured to; a parameter changes its gain in
proportion. https://ardupilot.org/copter/docs/parameters.html (ATC_, PSC_)
"""

from __future__ import annotations

HIGHEST = 1e3  # of any gain: beyond it the numbers, not the vehicle, would fly away

# Parameter -> (gain, its rows, gain for each unit of the parameter).
GAINS: dict[str, tuple[str, tuple[int, ...], float]] = {
    "PSC_POSXY_P": ("pos_p", (0, 1), 1.0),
    "PSC_POSZ_P": ("pos_p", (2,), 1.0),
    "PSC_VELXY_P": ("vel_p", (0, 1), 1.0),
    "PSC_VELXY_I": ("vel_i", (0, 1), 1.0),
    "PSC_VELZ_P": ("vel_p", (2,), 1.0),
    "PSC_ACCZ_I": ("vel_i", (2,), 1.0),
    "ATC_ANG_RLL_P": ("angle_p", (0,), 6.0 / 4.5),
    "ATC_ANG_PIT_P": ("angle_p", (1,), 6.0 / 4.5),
    "ATC_ANG_YAW_P": ("angle_p", (2,), 3.0 / 4.5),
    "ATC_RAT_RLL_P": ("rate_p", (0,), 18.0 / 0.135),
    "ATC_RAT_PIT_P": ("rate_p", (1,), 18.0 / 0.135),
    "ATC_RAT_YAW_P": ("rate_p", (2,), 7.0 / 0.3),
    "ATC_RAT_RLL_I": ("rate_i", (0,), 8.0 / 0.135),
    "ATC_RAT_PIT_I": ("rate_i", (1,), 8.0 / 0.135),
    "ATC_RAT_YAW_I": ("rate_i", (2,), 1.0 / 0.02),
}
