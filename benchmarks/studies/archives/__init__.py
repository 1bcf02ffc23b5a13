"""Archives of rooms of hidden firms."""
