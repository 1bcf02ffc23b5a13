"""The finder on means over positions, in rooms of other tracers and in measured ones."""
