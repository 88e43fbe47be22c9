"""Measuring the network between two hosts of a running fleet: streams, round trips, outages, capacity.

:mod:`mesh.bench.responder` runs beside every router; :mod:`mesh.bench.asker` tells two of them what to do and gathers
what they saw; the command line is one user of it.
"""
