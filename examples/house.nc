(House: a square with its roof, one line)
(Absolute coordinates in mm, from X0 Y0 Z0. About 10 minutes at these feeds)
G21
N1 G90
N2 G54
N10 G1 X20.0 Y20.0 Z0 F10
N11 X20 Y0.0 Z0
N12 X0 Y0
N13 X0.0 Y20 Z0
N14 X20 Y20.0 Z0 F20
N15 X10.0 Y25.0 Z0
N16 X0.0 Y20.0 Z0
