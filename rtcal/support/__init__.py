"""Helpers that every package uses: checks, types, files, progress, numba."""
