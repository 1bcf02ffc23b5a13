"""Rooms in which reality and the user's program are two different simulators."""
