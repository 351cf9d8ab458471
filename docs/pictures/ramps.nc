(Two lines with a corner: the first comes to its feed, the second may not.)
G21 G90
G1 X60 F3000
Y15
