"""``zmav tak``: the fleet as cursor on target, to a TAK server."""
