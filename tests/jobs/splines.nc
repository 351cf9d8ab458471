(Curves of third and second degree, and one of many control points)
G21 G90 G94
G1 X1 Y1 F600
G5 I2 J3 P-2 Q3 X5 Y1
G5 P1 Q-2 X8 Y2
G5.1 I1 J2 X10 Y0
G5.2 P1 L3
X10 Y2 P1
X8 Y4 P2
X4 Y4 P0.5
X2 Y0 P1
G5.3 F900
G0 X0 Y0
