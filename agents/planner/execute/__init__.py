"""A verified plan on real vehicles: commits, a common clock, progress, and what is done when it goes otherwise."""
