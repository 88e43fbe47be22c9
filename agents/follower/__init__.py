"""Stay above something that is seen: position commands only, whatever the aircraft and whatever it follows."""
