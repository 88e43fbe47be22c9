"""Refinement: from ways and first guesses to samples that every vehicle can fly and that keep all apart."""

from __future__ import annotations

from agents.planner.solve.refine.flyable import FACTORS, Refined, refine, refine_paths, squeeze

__all__ = ["FACTORS", "Refined", "refine", "refine_paths", "squeeze"]
