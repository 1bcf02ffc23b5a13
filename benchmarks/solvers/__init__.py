"""Solvers compared on calibrations with known answers: `python -m benchmarks.solvers`."""
