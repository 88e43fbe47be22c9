"""The viewer: the fleet in three dimensions and over time, in Rerun.

``zmav view`` reads the key space into a table of newest values (:mod:`~ground.view.table`); a painter in a process of
its own (:mod:`~ground.view.painter`) fetches from it what changed, at most ten times a second, and logs that to the
viewer. A viewer that stalls stalls its painter and nobody else.
"""
