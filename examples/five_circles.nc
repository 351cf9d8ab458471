(Five circles of 1 mm radius in a cross, each in a coordinate system of its)
(own. Sets G54 to G58 and leaves them set. About a minute)
(Each arc ends where it began, at X-2.0: a full circle. The listing that)
(this comes from writes X-10.0, a point off the circle: error 33 to Grbl)
G21 G90 G17 G94
G10 L2 P1 X0 Y0 Z0 (G54: origin of the machine)
G10 L2 P2 X10 (G55: right)
G10 L2 P3 X-10 (G56: left)
G10 L2 P4 Y10 (G57: up)
G10 L2 P5 Y-10 (G58: down)
G54 G0 X-2.0 Y0 Z0 (circle in the middle)
G1 F60 Z-1.00 (down by 1 mm)
G3 X-2.0 Y0 I1.0 J0 (round, 1 mm deep)
G0 Z0 (up)
G55 G0 X-2.0 Y0 Z0 (the next four in the same way)
G1 F60 Z-1.00
G3 X-2.0 Y0 I1.0 J0
G0 Z0
G56 G0 X-2.0 Y0 Z0
G1 F60 Z-1.00
G3 X-2.0 Y0 I1.0 J0
G0 Z0
G57 G0 X-2.0 Y0 Z0
G1 F60 Z-1.00
G3 X-2.0 Y0 I1.0 J0
G0 Z0
G58 G0 X-2.0 Y0 Z0
G1 F60 Z-1.00
G3 X-2.0 Y0 I1.0 J0
G0 Z0
M2 (end)
