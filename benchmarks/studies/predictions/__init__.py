"""Predictions and designs in rooms of other tracers."""
