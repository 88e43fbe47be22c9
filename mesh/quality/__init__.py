"""How well a router hears its neighbours: probes, what they tell, and what it costs to send over a link."""
