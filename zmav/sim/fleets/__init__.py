"""Fleets: what is stepped together."""
