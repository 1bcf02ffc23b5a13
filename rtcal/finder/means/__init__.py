"""The finder on means over positions: closed forms of T20, EDT, T30, C80 and G."""
