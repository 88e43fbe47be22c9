"""Three simulated copters in a line of routers."""
