"""Studies: worlds that simulate what is hidden from rtcal, their stored rooms, what judges by them."""
