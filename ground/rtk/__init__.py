"""``zmav rtk``: corrections for the GNSS receivers of the whole fleet, from a caster, a base receiver or a file."""
