"""Flies routes: references in time, held to limits of speed, acceleration and jerk, and how well they were followed."""
