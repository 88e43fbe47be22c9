"""Autopilot rules: one state machine per vehicle."""
