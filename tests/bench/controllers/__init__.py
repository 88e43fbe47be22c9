"""``python -m tests.bench.controllers``: the MAS paper's measurements, on this machine, with programs of their own."""
