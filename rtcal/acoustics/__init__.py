"""Physics: pure functions and frozen values, no optimisation."""
