"""``zmav gcs``: connect any ground control station to the whole fleet."""
