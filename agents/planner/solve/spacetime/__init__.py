"""Ways and times for all vehicles together in tight places: a discrete search that waits, yields and pushes."""
