"""What runs beside an autopilot: router, adapter, services."""
