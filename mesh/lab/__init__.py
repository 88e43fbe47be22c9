"""A fleet of network namespaces on one machine, joined by links whose delay, loss, rate and outages are set live."""
