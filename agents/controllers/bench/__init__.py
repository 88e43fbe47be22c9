"""``zmav agent bench``: the MAS paper's measurements, on this machine, with programs of their own."""
