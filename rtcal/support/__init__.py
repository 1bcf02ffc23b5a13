"""What every part stands on: checks, types, files, progress, numba."""
