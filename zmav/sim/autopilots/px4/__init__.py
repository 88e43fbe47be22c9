"""A PX4 multicopter, by what was measured on PX4 1.16 and is written in its user guide (docs.px4.io/v1.16)."""
