"""Who is who: certificates of the fleet's own authority, proofs of origin, and what each role may do."""

from __future__ import annotations

VARIABLE = "ZMAV_CREDENTIALS"
"""environment variable: the folder of the member that a program is"""
