"""What a fleet costs as it grows: simulated vehicles on real routers, measured, fitted, and the hierarchy that follows."""
