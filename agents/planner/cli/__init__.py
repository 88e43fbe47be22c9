"""The planner's verbs."""
