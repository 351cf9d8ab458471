(One axis at a time: the order of steps is the same at any speed, so a streamed run must have it too)
G21 G91 G94
G1 X2 F500
Y2 F300
X-1
Z0.5 F200
G0 Y-1.5
G1 X0.25 F60
Z-0.5
G0 X-1.25
M2
