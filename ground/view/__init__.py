"""``zmav view``: show the fleet in three dimensions."""
