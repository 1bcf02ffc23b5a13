; A rehearsal room of 9 m x 8 m x 3 m. Absorption in percent, octaves from 125 Hz.
ABS plaster = <14 10 6 5 4 3> {200 200 200}
ABS carpet = <8 24 57 69 71 73> {120 60 60}
CORNERS
