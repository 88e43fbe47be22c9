"""What the vehicles' sensors and estimators make of the truth."""
