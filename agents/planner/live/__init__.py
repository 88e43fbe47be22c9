"""The agent: goals and obstacles in from the key space, plans from the solver's process, a standby that takes over."""
