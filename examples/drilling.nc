(Drilling: a row of holes with a canned cycle, in inches)
(Runs in the seed dialect, $900=2: it moves after G80 without a motion word)
G0 G49 G40 G17 G80 G50 G90
; Rapid, no tool length, no cutter compensation, XY, no cycle, no scaling

M6 T0
; Tool change

G20 (Inch)

M03 S500
; Spindle on, 500 rpm

M08
; Coolant on

G90
; Absolute coordinates

G00 G43 H0 Z0.1
; Length of the tool in the spindle, 0.1 inch above the work

G73 X-7 Y-4 Z-0.75 Q0.2 R0.1 F10
; Drills in pecks of 0.2 inch at 10 inches a minute

X-5.8889
X-4.7778
X-3.6667
X-2.5556
X-1.4444
X-1.4444
X-0.3333
X0.7778
X1.8889
X3

G80
; No cycle any more

M5 M9
; Spindle and coolant off

X-7 Y-4
; Back to the first hole, as a rapid

M30
; End of the program
