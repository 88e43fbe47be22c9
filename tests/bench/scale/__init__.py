"""What a fleet costs as it grows: simulated vehicles on real routers, measured and fitted, and gateways of groups."""
