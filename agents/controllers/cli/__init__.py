"""Verbs of ``zmav agent`` that are for controllers."""
