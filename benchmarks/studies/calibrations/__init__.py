"""Calibrations of rooms that are not as stated, and their posteriors."""
