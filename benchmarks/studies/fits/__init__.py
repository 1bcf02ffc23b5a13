"""Calibrations to every position beside what else there is."""
