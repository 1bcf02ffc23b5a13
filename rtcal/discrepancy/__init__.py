"""What the model misses."""
