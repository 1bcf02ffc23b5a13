"""Simulators: what turns absorption coefficients into a decay. They never import calibration."""
