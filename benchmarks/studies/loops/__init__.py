"""The closed loop, in invented halls and beside other programs."""
