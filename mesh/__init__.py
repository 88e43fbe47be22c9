"""Routers, topologies, link quality and credentials: what makes a fleet reachable."""
