"""``zmav traffic``: who else is in the air, from receivers of ADS-B, for the whole fleet."""
