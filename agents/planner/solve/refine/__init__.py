"""Refinement: from ways and first guesses to samples that every vehicle can fly and that keep all apart."""
