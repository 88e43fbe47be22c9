"""Programs that run on or for vehicles; each joins the others only through the key space."""
