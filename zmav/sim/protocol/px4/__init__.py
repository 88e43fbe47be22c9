"""PX4's side of the MAVLink microservices, as measured on PX4 1.16."""
