"""What people sit in front of."""
