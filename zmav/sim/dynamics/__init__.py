"""Physics: rigid bodies, rotors and air, vectorised with numpy over all vehicles of one airframe."""
