"""Two states of a room: real ones and a hidden world."""
