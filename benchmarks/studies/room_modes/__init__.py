"""Calibrations to room modes in a wave world."""
