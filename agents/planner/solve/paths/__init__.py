"""Single vehicles' ways through the static world."""
