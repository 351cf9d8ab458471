//! Tests of the sentences that explain why a line was refused: the wrong word, and what to write instead. Each row is a
//! wrong line as a person or a CAM program writes it, with its error and the whole sentence.

#![cfg(all(feature = "full", feature = "reasons"))]

use crate::program::Program;
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{Action, Dialect, Direction, Held, HeldLine, Reason};
use proptest::prelude::*;

/// Lines that set the state (separated by ` | `), the refused line, the number of its error, and the sentence.
type Row = (&'static str, &'static str, u8, &'static str);

/// Rows in Oxmill's dialect.
const ROWS: &[Row] = &[
    ("F100", "G1 X", 2, "no number behind X"),
    ("F100", "G1 XY5", 2, "no number behind X"),
    ("F100", "G1 X Y5", 2, "no number behind X"),
    ("F100", "G1 X- Y5", 2, "no number behind X"),
    ("F100", "G1 X.", 2, "no number behind X"),
    ("F100", "G1 X5 Y", 2, "no number behind Y"),
    ("F100", "G1 X5 F", 2, "no number behind F"),
    ("F100", "G X5", 2, "no number behind G"),
    ("F100", "M", 2, "no number behind M"),
    ("F100", "G1 X1,5", 1, "comma in X1,5: write a decimal point"),
    ("F100", "G1 X1.5 Y-2,25 F300", 1, "comma in Y-2,25: write a decimal point"),
    ("F100", "G1 X1,500.5", 1, "comma in X1,500.5: write a decimal point"),
    ("F100", "G1 X,5", 2, "comma in X,5: write a decimal point"),
    ("F100", "G1 X1..2", 1, "two points in X1..2"),
    ("F100", "G1 X1.2.3", 1, "two points in X1.2.3"),
    ("F100", "G1 X1O", 2, "letter O in X1O: write a 0"),
    ("F100", "G1 X1O5 Y2", 36, "letter O in X1O5: write a 0"),
    ("F100", "GO X1", 2, "letter O in GO: write a 0"),
    ("F100", "GO1 X1 F100", 2, "letter O in GO1: write a 0"),
    ("F100", "G1 X-O.5", 2, "letter O in X-O.5: write a 0"),
    ("F100", "G1 XO Y2", 2, "letter O in XO: write a 0"),
    ("F100", "G1 X1O.5", 36, "letter O in X1O.5: write a 0"),
    ("F100", "G1 X5mm", 2, "no unit may follow X5: remove it, G21 is mm, G20 inch"),
    ("F100", "G1 X5mm Y3", 2, "no unit may follow X5: remove it, G21 is mm, G20 inch"),
    ("F100", "G1 X2in", 2, "no unit may follow X2: remove it, G21 is mm, G20 inch"),
    ("F100", "G1 X2\"", 1, "\" in X2\" is no part of a number"),
    ("F100", "G1 X=5", 2, "no = in a word: write X5"),
    ("F100", "G1 X:5", 2, ": in X:5 is no part of a number"),
    ("F100", "10", 1, "no letter in front of 10"),
    ("F100", "-5 X3", 1, "no letter in front of -5"),
    ("F100", ".5", 1, "no letter in front of .5"),
    ("F100", "X3 ) Y2", 1, "a parenthesis is closed that was not opened, behind X3"),
    ("F100", ") X3", 1, "a parenthesis is closed that was not opened, behind the beginning"),
    ("F100", "G1 X5?", 1, "? in X5? is no part of a number"),
    ("F100", "* X5", 1, "* begins no word"),
    ("F100", "! X5", 1, "! begins no word"),
    ("F100", "G1 X5 %", 1, "% has to be alone in its line"),
    ("F100", "%G0 X1", 1, "% has to be alone in its line"),
    ("F100", "G1 / X5", 1, "/ skips a line only as its first character"),
    ("F100", "G1 X5/2", 1, "write 5/2 in brackets behind X"),
    ("F100", "G1 X5*2", 1, "write 5*2 in brackets behind X"),
    ("F100", "G1 X5+2", 1, "write 5+2 in brackets behind X"),
    ("F100", "G1 X10-2.5", 1, "write 10-2.5 in brackets behind X"),
    ("F100 | #101=5", "G1 X#101+2", 1, "write #101+2 in brackets behind X"),
    ("F100 | #101=5", "G1 X#101*2 Y3", 1, "write #101*2 in brackets behind X"),
    (
        "F100 | #101=5",
        "G1 X[#101]+2",
        1,
        "X continues after its bracket: put one pair of brackets around the whole value",
    ),
    ("F100 | #101=5", "G1 X-#101-2", 1, "write -#101-2 in brackets behind X"),
    ("F100", "#101=5+2", 1, "write 5+2 in brackets behind #101="),
    ("F100", "#101=[5]*2", 1, "#101 continues after its bracket: put one pair of brackets around the whole value"),
    ("F100", "#101", 75, "#101 has no letter in front, or no = behind"),
    ("F100", "#101 5", 75, "#1015 has no letter in front, or no = behind"),
    ("F100", "#=5", 75, "no number and no name behind #"),
    ("F100", "#101=", 75, "no value behind #101="),
    ("F100", "G1 X#", 75, "no number behind X#"),
    ("F100", "G1 X[5+2", 75, "a bracket is not closed in X"),
    ("F100", "G1 X[5+[2*3]", 75, "a bracket is not closed in X"),
    ("F100", "G1 X[5+2]]", 1, "a bracket is closed that was not opened, in X"),
    ("F100", "G1 X5]", 1, "a bracket is closed that was not opened, in X5"),
    ("F100", "G1 X[]", 75, "nothing is in the brackets of X"),
    ("F100", "G1 X[5+]", 75, "no value behind + in the brackets of X"),
    ("F100", "G1 X[5,5]", 75, "comma in X: write a decimal point"),
    ("F100", "G1 X[1/0]", 72, "X is divided by zero"),
    ("F100", "G1 X[1 MOD 0]", 72, "X is divided by zero"),
    ("F100", "G1 X[5/#7]", 72, "X is divided by zero"),
    ("F100", "G1 XSQRT[-1]", 73, "SQRT in X takes values not below 0"),
    ("F100", "G1 XLN[0]", 73, "LN in X takes values above 0"),
    ("F100", "G1 XASIN[2]", 73, "ASIN in X takes values from -1 to 1"),
    ("F100", "G1 XACOS[1.5]", 73, "ACOS in X takes values from -1 to 1"),
    ("F100", "G1 X[[-2]**0.5]", 73, "a power in X has a negative base and a fraction as exponent"),
    ("F100", "G1 X[FOO[2]]", 71, "FOO in X is no function and no operator"),
    ("F100", "G1 X[2 POW 3]", 71, "POW in X is no function and no operator"),
    ("F100", "G1 X[SINE[3]]", 71, "SINE in X is no function and no operator"),
    ("F100", "G1 X[1000000000000**9]", 76, "the value of X is too large"),
    ("F100", "G1 X#<depth>", 74, "#<DEPTH> is not set above this line: set it, or correct the name"),
    ("F100", "G1 Z-#<depth> F#<feed>", 74, "#<DEPTH> is not set above this line: set it, or correct the name"),
    ("F100", "G1 X[#<depth>*2]", 74, "#<DEPTH> is not set above this line: set it, or correct the name"),
    ("F100", "G1 X#6000", 74, "#6000 does not exist: parameters are #1 to #5999"),
    ("F100", "#6000=1", 74, "#6000 does not exist: parameters are #1 to #5999"),
    ("F100", "#5420=1", 200, "#5420 belongs to the machine: set one of your own, such as #100"),
    ("F100", "#<_x>=1", 200, "#<_X> belongs to the machine: set one of your own, such as #100"),
    ("F100", "#<name=5", 75, "the name in #< is not closed with >"),
    ("F100", "G1 X1 X2", 25, "X is twice in the line: X1 and X2"),
    ("F100", "G1 F100 X1 F200", 25, "F is twice in the line: F100 and F200"),
    ("F100", "T1 M6 T2", 25, "T is twice in the line: T1 and T2"),
    ("F100", "N10 G1 X1 N20", 25, "N is twice in the line: N10 and N20"),
    ("F100", "G0 G1 X1", 24, "G0 and G1 in one line: write one of them, or two lines"),
    ("F100", "G1 X1 G0 Z5", 24, "G1 and G0 in one line: write one of them, or two lines"),
    ("F100", "G0 X1 G0 Y1", 24, "G0 is twice in the line: write it once, or two lines"),
    ("F100", "G90 G91", 21, "G90 and G91 in one line: write one of them, or two lines"),
    ("F100", "G17 G18 G2 X1 I1", 21, "G17 and G18 in one line: write one of them, or two lines"),
    ("F100", "G20 G21", 21, "G20 and G21 in one line: write one of them, or two lines"),
    ("F100", "G54 G55", 21, "G54 and G55 in one line: write one of them, or two lines"),
    ("F100", "M3 M4 S1000", 21, "M3 and M4 in one line: write one of them, or two lines"),
    ("F100", "M3 S1000 M5", 21, "M3 and M5 in one line: write one of them, or two lines"),
    ("F100", "M7 M8", 21, "M7 and M8 in one line: write one of them, or two lines"),
    ("F100", "M0 M30", 21, "M0 and M30 in one line: write one of them, or two lines"),
    ("F100", "G92 X0 G0 X5", 24, "G92 and G0 in one line: both want the axis words, write two lines"),
    ("F100", "G28 G92 X0", 24, "G28 and G92 in one line: write one of them, or two lines"),
    ("F100", "G10 L2 P1 X0 G0 X5", 24, "G10 and G0 in one line: both want the axis words, write two lines"),
    ("F100", "G4 P1 G92 X0", 21, "G4 and G92 in one line: write one of them, or two lines"),
    ("F100", "G0 G28 X0", 24, "G0 and G28 in one line: both want the axis words, write two lines"),
    ("F100", "G81 G83 X1 Z-1 R1 Q1", 24, "G81 and G83 in one line: write one of them, or two lines"),
    ("F100", "G93 G94", 21, "G93 and G94 in one line: write one of them, or two lines"),
    ("F100", "G43 H1 G49", 21, "G43 and G49 in one line: write one of them, or two lines"),
    ("F100", "M6 M61 Q1", 21, "M6 and M61 in one line: write one of them, or two lines"),
    ("F100", "M70 G0 X1", 21, "M70 has to be alone in its line"),
    ("F100", "S-100 M3", 4, "S-100 must not be negative"),
    ("F100", "F-100", 4, "F-100 must not be negative"),
    ("F100", "T-1", 4, "T-1 must not be negative"),
    ("F100", "N-5 G0 X1", 4, "N-5 must not be negative"),
    ("F100", "G4 P-1", 4, "P-1 must not be negative"),
    ("F100", "G6 X1", 20, "G6 is no G word that is known"),
    ("F100", "G38 Z-5", 20, "G38 lacks its digit: G38.2 to G38.5 are probing moves"),
    ("F100", "G38.6 Z-5", 20, "G38.6 is no G word that is known"),
    ("F100", "G90.2", 20, "G90.2 is no G word that is known"),
    ("F100", "G1.5 X1", 23, "G1.5 is not known: G1 has no fraction"),
    ("F100", "G17.1", 23, "G17.1 is not known: G17 has no fraction"),
    ("F100", "G200", 20, "G200 is no G word that is known"),
    ("F100", "G999", 20, "G999 is no G word that is known"),
    ("F100", "G-1", 20, "G-1 is no G word that is known"),
    ("F100", "M100", 20, "M100 needs a macro of its number ($M0=o150 sub for M150) and a line of its own"),
    ("F100", "M3.5", 23, "M3.5 is not known: M words have whole numbers up to 255"),
    ("F100", "M99999", 20, "M99999 is no M word that is known"),
    ("F100", "G59.4", 29, "G59.4 is no coordinate system: there are G54 to G59, G59.1, G59.2 and G59.3"),
    ("F100", "G54.5 X1", 29, "G54.5 is no coordinate system: there are G54 to G59, G59.1, G59.2 and G59.3"),
    ("F100", "M104 S200", 20, "M104 is a word of 3-D printers: make the program for a mill"),
    ("F100", "M109 S210", 20, "M109 is a word of 3-D printers: make the program for a mill"),
    ("F100", "M140 S60", 20, "M140 is a word of 3-D printers: make the program for a mill"),
    ("F100", "M82", 20, "M82 is a word of 3-D printers: make the program for a mill"),
    ("F100", "G29", 20, "G29 is a word of 3-D printers: make the program for a mill"),
    ("F100", "M84", 20, "M84 is a word of 3-D printers: make the program for a mill"),
    ("F100", "M107", 20, "M107 is a word of 3-D printers: make the program for a mill"),
    ("F100", "G1 X1 Y2 E0.5", 36, "E0.5 is for the extruder of a 3-D printer: make the program for a mill"),
    ("F100", "G41 D1", 122, "G41 is not supported: let the CAM program offset the path by the radius of the cutter"),
    ("F100", "G42", 122, "G42 is not supported: let the CAM program offset the path by the radius of the cutter"),
    (
        "F100",
        "G33 Z-5 K1",
        121,
        "G33 is not supported: nothing measures the spindle. Drill (G81), mill the thread (G3 with Z)",
    ),
    (
        "F100",
        "G76 Z-1",
        121,
        "G76 is not supported: nothing measures the spindle. Drill (G81), mill the thread (G3 with Z)",
    ),
    (
        "F100",
        "G84 X1 Z-5 R1",
        121,
        "G84 is not supported: nothing measures the spindle. Drill (G81), mill the thread (G3 with Z)",
    ),
    ("F100 | G95 F0.1", "G1 X1", 22, "S is missing: the feed of G95 is F times S"),
    ("S100 | G95", "G1 X1", 22, "F is missing: no feed has been set for G1"),
    ("F100", "G30 P3 Z0", 39, "P3 in G30 is not stored: there are G28 and G30, which is P2"),
    (
        "F100",
        "M10",
        20,
        "M10 needs a macro (o10 sub or o11 sub in $M0=) and a line of its own. For outputs use M64, M65",
    ),
    (
        "F100",
        "G74 Z-5 R1",
        121,
        "G74 is not supported: tapping needs a measured spindle, and pecking is G73. Mill the thread (G2 with Z)",
    ),
    ("F100", "G68.2 X1", 121, "G68.2 is not supported: tilted planes need five axes"),
    ("F100", "GOTO 20", 121, "GOTO is for subprograms and loops: the lines around this one are not held"),
    (
        "F100",
        "IF #1 EQ 1 GOTO 5",
        2,
        "IF#1EQ1GOTO5 is not supported: write IF with THEN or GOTO, or WHILE with DO; put values in brackets",
    ),
    ("F100", "END2", 81, "END2 has no WHILE .. DO2 before it"),
    ("F100", "G96 S200", 121, "G96 is not supported: write G97 and S in revolutions per minute"),
    ("F100", "G7", 121, "G7 is not supported: there is no lathe mode, X is no diameter"),
    ("F100", "G8", 121, "G8 is not supported: there is no lathe mode, X is no diameter"),
    ("F100", "G12", 28, "I is missing in G12: the radius of the circle"),
    ("F100", "G13 I0", 39, "I0 in G13 must be above 0: the radius"),
    ("F100", "G13 I5 K10 Q2", 36, "K10 in G13 is a word of Haas, where I is the wall: let CAM write G2 and G3"),
    ("F100", "G13 Z-1 I5", 36, "Z-1 in G13 is a word of Haas, where I is the wall: let CAM write G2 and G3"),
    ("F100", "G12 X1 I5", 36, "X1 does not go with G12: its circle is round the tool"),
    (
        "F100 | D3",
        "G12 I5",
        121,
        "G12 after a D word: I may be the wall's radius (Haas). If it is the tool path's, write D0 above",
    ),
    ("F100", "G93 G12 I5 F2", 120, "G12 needs G94: G93 is active"),
    ("F100", "G18 G13 I5", 140, "G13 needs G17: the plane is G18"),
    ("F100", "G16", 121, "G16 is not supported: write X and Y instead of angle and radius"),
    ("F100", "G51.1 X0", 121, "G51.1 is not supported: G51 with a negative I or J mirrors"),
    ("F100", "G66 P100 A#1", 121, "G66 takes plain numbers: each of its calls gets the same ones"),
    ("F100", "G66 A1", 28, "P is missing in G66: the number of a subprogram"),
    (
        "F100",
        "G0 G66 P100",
        121,
        "G66 calls a subprogram only at the beginning of its line, as a plain number: G65 P1001",
    ),
    (
        "F100",
        "G0 G65 P100",
        121,
        "G65 calls a subprogram only at the beginning of its line, as a plain number: G65 P1001",
    ),
    ("F100", "M3 M98.0 P1", 121, "M98.0 must be written as a plain number: M98 P1001, M99"),
    ("F100", "M[98] P1", 121, "a computed M word is none that is supported: write its number, such as M98 P1001"),
    ("F100", "M97 P1000", 121, "M97 is not supported: write O1000 .. M99 behind M30, and call it with M98 P1000"),
    ("F100", "M98 L2", 28, "P is missing in M98: the number of a subprogram"),
    ("F100", "M98 P1 X2", 36, "M98 takes only P and L: write other words on a line of their own"),
    ("F100", "G0 X1 M98 P1 X2", 36, "M98 takes only P and L: write other words on a line of their own"),
    ("F100", "M98 P1 L0", 39, "P of M98 has up to 8 digits, and L is 1 to 9999"),
    ("F100", "M98 P1.5", 23, "P and L of M98 are whole numbers"),
    ("F100", "M98 P-1", 4, "P of M98 is negative"),
    ("F100", "G65 P1 A1 A2", 25, "G65 has a letter twice"),
    ("F100", "G65 P1 N2", 36, "G65 takes P, L and arguments, which are letters except G, L, N, O and P"),
    ("F100", "G65 P1 A#<depth>", 74, "#<DEPTH> is not set above this line: set it, or correct the name"),
    ("F100", "G65 P1 A", 2, "G65 has a letter without a number"),
    (
        "F100",
        "M99",
        203,
        "M99 without a call: lines above may have run. Write subprograms after M30; stop the sender, send $X",
    ),
    (
        "F100",
        "G0 X1 M99",
        203,
        "M99 without a call: lines above may have run. Write subprograms after M30; stop the sender, send $X",
    ),
    ("M98 P1001 | M30", "G0 X1", 203, "G0X1 belongs to no program that can run: stop the sender, then send $X"),
    (
        "M98 P1 | M30 | O1",
        "O2",
        203,
        "O2 cannot start here: end the subprogram above with M99, use each number once, then send $X",
    ),
    ("M30 | O1", "M30", 203, "M30 is no end of a subprogram: M99 is; for the next program send $X first"),
    ("M30 | O1", "M99 P20", 121, "M99 must be alone in its line: it returns to the line after its call"),
    (
        "M98 P1",
        "N5 IF#1 EQ 0 GOTO 10",
        121,
        "N5IF#1EQ0GOTO10 is not supported: write IF with THEN or GOTO, or WHILE with DO; put values in brackets",
    ),
    ("M30 | O1", "o2 sub", 81, "O2 SUB is inside another subroutine: write it above that one"),
    ("F100", "M19", 121, "M19 is not supported: the spindle cannot be turned to an angle"),
    (
        "F100",
        "G87 X1",
        121,
        "G87 is not supported: it needs a spindle that stops at an angle. Write the back boring as single moves",
    ),
    ("F100", "@5", 121, "@5 is not supported: write X and Y instead of angle and radius"),
    ("F100", "A90", 20, "A90 is no axis of this machine"),
    ("F100", "G1 B45", 20, "B45 is no axis of this machine"),
    ("F100", "G1 U1", 149, "U1 is no axis here: there are no U, V and W. Choose a post-processor for X, Y and Z"),
    ("F100", "G1 W-3", 149, "W-3 is no axis here: there are no U, V and W. Choose a post-processor for X, Y and Z"),
    ("F100", "G0 X1 V2", 149, "V2 is no axis here: there are no U, V and W. Choose a post-processor for X, Y and Z"),
    ("F100", "T100000 M6", 38, "T100000 is too high: tools go up to 99999"),
    ("F100", "T1.5 M6", 23, "T1.5 has to be a whole number"),
    ("F100", "M61", 28, "Q is missing in M61: the number of the tool"),
    ("F100", "M61 Q-1", 4, "Q-1 must not be negative"),
    ("F100", "M61 Q100000", 38, "Q100000 is too high: tools go up to 99999"),
    ("F100", "M61 Q1.5", 23, "Q1.5 has to be a whole number"),
    ("", "G1 X5", 22, "F is missing: no feed has been set for G1"),
    ("", "G1 X5 F0", 22, "F0 is no feed: it must be above 0"),
    ("", "G2 X5 I2.5", 22, "F is missing: no feed has been set for G2"),
    ("", "G81 X1 Z-1 R1", 22, "F is missing: no feed has been set for G81"),
    ("", "G38.2 Z-10", 22, "F is missing: no feed has been set for G38.2"),
    ("F100 | G93", "G1 X5", 22, "F is missing: G93 needs one in each line that moves"),
    ("F100", "N99999999 G0 X1", 27, "N99999999 is too high: line numbers go up to 10000000"),
    ("F100", "G2", 26, "X and Y are missing in G2: where the arc ends"),
    ("F100", "G2 F200", 26, "X and Y are missing in G2: where the arc ends"),
    ("F100", "G38.2", 26, "no axis word in G38.2: add X, Y or Z"),
    ("F100", "G92", 26, "no axis word in G92: add X, Y or Z"),
    ("F100", "G10 L2 P1", 26, "no axis word in G10: add X, Y or Z"),
    ("F100", "G52", 26, "no axis word in G52: add X, Y or Z"),
    ("F100", "G81", 26, "no axis word in G81: add X, Y or Z"),
    ("F100", "G81 R1", 26, "no axis word in G81: add X, Y or Z"),
    ("F100", "G83 X1 Z-5 R1", 28, "Q is missing in G83: the depth of each peck in program units, above 0, such as Q2"),
    ("F100", "G83 X1 Z-5 Q1", 28, "R is missing in G83: where the feed begins"),
    ("F100", "G81 X1 R1", 28, "Z is missing in G81: the bottom of the hole"),
    ("F100", "G81 X1 Y2 Z-5", 28, "R is missing in G81: where the feed begins"),
    ("F100", "G82 X1 Z-5 R1", 28, "P is missing in G82: how many seconds to wait"),
    ("F100", "G73 X1 Z-5 R2", 28, "Q is missing in G73: the depth of each peck in program units, above 0, such as Q2"),
    ("F100 | G18", "G81 X1 R1 Z2", 28, "Y is missing in G81: the bottom of the hole"),
    ("F100", "G83 X1 Z-5 R1 Q0", 39, "Q0 in G83 must be above 0: the depth of each peck"),
    ("F100", "G83 X1 Z-5 R1 Q-1", 39, "Q-1 in G83 must be above 0: the depth of each peck"),
    ("F100", "G81 X1 Z-5 R1 L0", 39, "L0 in G81 has to be 1 to 1000000: how many holes"),
    ("F100", "G81 X1 Z-5 R1 L1.5", 23, "L1.5 has to be a whole number"),
    ("F100", "G81 X1 Z5 R1", 54, "R1 lies below Z5, the bottom of the hole"),
    ("F100", "G81 X1 Z-5 R1 Q2", 36, "Q2 is used by nothing: G81 takes no Q"),
    ("F100", "G81 X1 Z-5 R1 P2", 36, "P2 is used by nothing: G81 takes no P"),
    ("F100 | G93", "G81 X1 Z-5 R1 F100", 120, "G81 needs G94: G93 is active"),
    ("F100", "G86 X1 Z-5 R1 P0", 41, "G86 stops the spindle, which is off: write M3 and S before it"),
    ("F100", "G53 G81 X1 Z-1 R1", 30, "G53 needs G0 or G1: G81 is active"),
    ("F100", "G4", 28, "P is missing in G4: how many seconds"),
    ("F100", "G4 S1", 28, "P is missing in G4: how many seconds"),
    ("F100", "G4 X1", 28, "P is missing in G4: how many seconds"),
    ("F100", "G10 X0", 28, "L is missing in G10: L2 P1 sets the origin of G54, L20 P1 the place of the tool in it"),
    ("F100", "G10 P1 X0", 20, "L is missing in G10: L2 sets the origin, L20 the place of the tool"),
    ("F100", "G10 L3 P1 X0", 20, "L3 in G10 is not known: there are L1, L2, L10, L11 and L20"),
    ("F100", "G10 L2 P10 X0", 29, "P10 in G10 is no coordinate system: P1 to P9"),
    ("F100", "G10 L1 Z5", 28, "P is missing in G10: the number of the tool"),
    ("F100", "G10 L1 P0 Z5", 47, "P0 is no tool of the table: they begin with P1"),
    ("F100", "G10 L1 P5", 47, "P5 is not in the table of tools: G10 L1 P5 Z<length> enters it"),
    ("F100", "G10 L1 P1.5 Z5", 23, "P1.5 has to be a whole number"),
    ("F100", "G10 L2 P1.5 X0", 23, "P1.5 has to be a whole number"),
    ("F100", "G43.1", 37, "Z is missing in G43.1: the length of the tool"),
    ("F100", "G43.2", 28, "H is missing in G43.2: the number of the tool"),
    ("F100 | G10 L1 P1 Z5", "G43 H5", 47, "H5 is not in the table of tools: G10 L1 P5 Z<length> enters it"),
    (
        "F100 | G10 L1 P1 Z5 | T3 M6",
        "G43",
        47,
        "T3 in the spindle is not in the table of tools: G10 L1 P3 Z<length> enters it",
    ),
    ("F100", "G43 H1.5", 23, "H1.5 has to be a whole number"),
    ("F100", "G54.1 X1", 28, "P is missing in G54.1: P1 to P3"),
    ("F100", "G54.1 P4", 29, "P4 in G54.1 is no coordinate system: P1 to P3"),
    ("F100", "G53 G2 X2 I1", 30, "G53 needs G0 or G1: G2 is active"),
    ("F100 | G2 X2 I1", "G53 X5", 30, "G53 needs G0 or G1: G2 is active"),
    ("F100 | G80", "G53 X5", 30, "G53 needs G0 or G1: G80 is active"),
    ("F100 | G80", "X5 Y5", 31, "X5 has no motion: G80 is active, write G0 or G1"),
    ("F100 | G80", "Z-3", 31, "Z-3 has no motion: G80 is active, write G0 or G1"),
    ("F100", "G2 Z1 R1", 32, "X or Y is missing in G2: the plane is G17"),
    ("F100 | G18", "G2 Y1 R1", 32, "X or Z is missing in G2: the plane is G18"),
    ("F100", "G2 X5", 35, "I and J are missing in G2, or R: the plane is G17"),
    ("F100", "G2 X5 Y5", 35, "I and J are missing in G2, or R: the plane is G17"),
    ("F100", "G2 X1 K1", 35, "I and J are missing in G2, or R: the plane is G17"),
    ("F100 | G18", "G3 X1", 35, "I and K are missing in G3, or R: the plane is G18"),
    ("F100 | G90.1", "G2 X5 I2", 35, "I and J are both needed in G2: G90.1 is active"),
    // A lost zero, swapped digits and a wrong sign: only the probable centre is suggested.
    (
        "F100 | G0 X0 Y-25",
        "G2 X-25 Y0 I0 J52",
        33,
        "the radius of G2 is 52.000 mm at its start, 36.797 at its end. Write I0.000 J25.000",
    ),
    (
        "F100 | G0 X60",
        "G2 X30 Y-30 I-3 J0",
        33,
        "the radius of G2 is 3.000 mm at its start, 40.361 at its end. Write I-30.000 J0.000",
    ),
    (
        "F100",
        "G2 X10 Y10 I-10 J0",
        33,
        "the radius of G2 is 10.000 mm at its start, 22.361 at its end. Write I10.000 J0.000",
    ),
    ("F100", "G2 X10 I4", 33, "the radius of G2 is 4.000 mm at its start, 6.000 at its end. Write I5.000 J0.000"),
    // The sentence suggests only one centre, because the other one would need a word beyond 50 m.
    (
        "F100",
        "G2 X-2424.506 Y48.5 I787.67",
        33,
        "the radius of G2 is 787.670 mm at its start, 3212.542 at its end. Write I-1212.738 J0.000",
    ),
    (
        "F100",
        "G3 X10 Y10 I10 J0.5",
        33,
        "the radius of G3 is 10.012 mm at its start, 9.500 at its end. Write I10.000 J0.000, or I9.500 J0.500",
    ),
    (
        "F100 | G90.1",
        "G2 X10 I4 J0",
        33,
        "the radius of G2 is 4.000 mm at its start, 6.000 at its end. Correct I, J or the end",
    ),
    (
        "F100 | G20",
        "G2 X1 I.4",
        33,
        "the radius of G2 is 10.160 mm at its start, 15.240 at its end. Correct I, J or the end",
    ),
    ("F100", "G2 X10 R4", 34, "R4 is too small for G2: at least 5.000 mm (half the chord)"),
    ("F100", "G2 X10 R0", 34, "R0 is too small for G2: at least 5.000 mm (half the chord)"),
    ("F100", "G2 X10.0005 R4", 34, "R4 is too small for G2: at least 5.001 mm (half the chord)"),
    ("F100", "G2 X0 Y0 R5", 33, "G2 with R ends where it begins: write I and J for a full circle"),
    ("F100 | G20", "G2 X1 R.4", 34, "R.4 is too small for G2: at least 12.700 mm (half the chord)"),
    ("F100", "G2 X5 R2.5 P1.5", 23, "P1.5 has to be a whole number"),
    ("F100", "G2 X5 R2.5 P0", 23, "P0 in G2 is the number of turns: 1 to 1000000"),
    ("F100", "G2 X5 I2.5 R2.5", 36, "I2.5 does not go with R2.5 in an arc: write one of them"),
    ("F100", "G2 X1 I99999999", 33, "I99999999 is beyond 50 m"),
    ("F100", "G0 X60000", 33, "X60000 is beyond 50 m from the origin of the machine"),
    ("F100 | G20", "G0 X3000", 33, "X3000 is beyond 50 m from the origin of the machine"),
    ("F100 | G91 | G0 X40000", "G0 X20000", 33, "X20000 is beyond 50 m from the origin of the machine"),
    ("F100", "G28 X60000", 33, "X60000 is beyond 50 m from the origin of the machine"),
    ("F100", "G10 L2 P1 X60000", 33, "the offset of X60000 would be beyond 50 m"),
    ("F100", "G92 X60000", 33, "the offset of X60000 would be beyond 50 m"),
    ("F100", "G52 Z60000", 33, "the offset of Z60000 would be beyond 50 m"),
    ("F100", "G43.1 Z60000", 33, "the offset of Z60000 would be beyond 50 m"),
    ("F100", "G38.2 X0", 33, "G38.2 ends where it begins: name a place to probe towards"),
    ("F100", "G81 X1 Z-60000 R1", 33, "Z-60000 is beyond 50 m from the origin of the machine"),
    ("F100", "G5 X60000 Y1 I1 J1 P1 Q1", 33, "X60000 is beyond 50 m from the origin of the machine"),
    ("F100", "G0 X1 P1", 36, "P1 is used by nothing in this line: take it out"),
    ("F100", "G1 X10 Y10 I5 J0", 36, "I5 belongs to an arc, but G1 is active: write G2 or G3"),
    ("F100", "G1 X10 R5", 36, "R5 belongs to an arc or a cycle, but G1 is active"),
    ("F100", "G0 X1 H5", 36, "H5 is used by nothing: G43 is missing"),
    ("F100", "G1 X5 D1", 36, "D1 is used by nothing: there is no cutter compensation"),
    ("F100", "G0 X1 Q2", 36, "Q2 is used by nothing: G0 takes no Q"),
    ("F100", "G0 X1 L2", 36, "L2 is used by nothing in this line: take it out"),
    ("F100", "M3 P1", 36, "P1 is used by nothing in this line: take it out"),
    ("F100", "G5 X1 Y1 P1", 28, "P and Q are both needed in G5: to its last control point"),
    ("F100", "G5 X1 Y1 P1 Q1", 28, "I and J are both needed in G5: to its first control point"),
    ("F100", "G5 X1 Y1 I1 P1 Q1", 28, "I and J are both needed in G5: to its first control point"),
    ("F100", "G5.1 X1 Y1", 28, "I and J are both needed in G5.1: to its first control point"),
    ("F100", "G5.1 X1 Y1 I1", 28, "I and J are both needed in G5.1: to its first control point"),
    ("F100 | G18", "G5.1 X1 Y1 I1 J1", 140, "G5.1 needs G17: the plane is G18"),
    ("F100", "G5.1 X1 Y1 Z1 I1 J1", 140, "Z1 does not go with G5.1: write it in a line of its own"),
    ("F100", "G5.3", 145, "G5.3 has no G5.2 before it that begins where the tool is"),
    ("F100 | G5.2 X1 Y1 P1", "G5.3", 147, "G5.3 needs at least L control points (order L), the start included"),
    ("F100 | G5.2 X1 Y1 P1", "G1 X5", 146, "G1 comes before G5.3 has ended the control points"),
    ("F100 | G5.2 X1 Y1 P1", "X2", 28, "P is missing in G5.2: the weight of the point"),
    ("F100", "G5.2 X1 Y1", 28, "P is missing in G5.2: the weight of the point"),
    ("F100", "G5.2 X1 Y1 P0", 39, "P0 in G5.2 must be above 0: the weight"),
    ("F100", "G5.2 X1 Y1 P1 L99", 39, "L99 in G5.2 is no order that there is"),
    ("F100", "G68 X1 Y1", 28, "R is missing in G68: the angle"),
    ("F100", "G68 Z1 R30", 31, "Z1 does not go with G68: it has no such axis"),
    (
        "F100 | G68 X0 Y0 R30 | G18",
        "G2 X1 Z1 R5",
        126,
        "G2 is not in the plane in which the coordinates are rotated: G69 ends the rotation",
    ),
    ("F100 | G68 X0 Y0 R30", "G92 X0", 127, "G92 does not go while G68 acts: write G69 before it"),
    ("F100", "G51 X0", 28, "P is missing in G51: the factor, or I, J and K"),
    ("F100", "G51 X0 P0", 39, "P0 in G51 must not be 0"),
    ("F100", "G51 X0 K-1", 39, "K-1 in G51 must be above 0: Z cannot be mirrored"),
    ("F100", "G51 X0 P1000", 151, "P1000 is above 100 in G51: P1 is the size as programmed"),
    ("F100 | G51 X0 P2", "G92 X0", 143, "G92 does not go while G51 acts: write G50 before it"),
    ("F100 | G51 X0 I2 J3", "G2 X5 R2.5", 142, "G2 would be an ellipse: the factors of G51 in its plane differ"),
    ("F100", "M62", 28, "P is missing in M62: the number of the output"),
    ("F100", "M66", 28, "P is missing in M66: the number of the input"),
    ("F100", "M66 P0 L3", 28, "Q is missing in M66: how many seconds to wait at most"),
    ("F100", "M66 P0 L5 Q1", 39, "L5 in M66 is not known: L0 to L4"),
    ("F100", "M67 Q1", 28, "E is missing in M67: the number of the output"),
    ("F100", "M68 E0", 28, "Q is missing in M68: the value of the output"),
    ("F100", "M50 P2", 39, "P2 in M50 has to be P0 or P1"),
    ("F100", "M52 P1", 121, "M52 is not supported with this P: there is no adaptive feed, and feed hold stays on"),
    ("F100", "M53 P0", 121, "M53 is not supported with this P: there is no adaptive feed, and feed hold stays on"),
    ("F100", "M72", 123, "M72 has nothing to restore: M70 or M73 keeps a state before it"),
    ("F100", "M72 X1", 21, "M72 has to be alone in its line"),
    ("F100", "M63 P-1", 4, "P-1 must not be negative"),
    ("F100", "M63 P1.5", 23, "P1.5 has to be a whole number"),
    ("F100", "G64 P0.1 Q-1", 4, "Q-1 must not be negative"),
    ("F100", "o100 call", 81, "no subroutine 100 above this line"),
    ("F100", "o<drill> call [5]", 81, "no subroutine <DRILL> above this line"),
    ("F100", "o[#1] call", 81, "no subroutine above this line has the number of this call"),
    ("F100", "o100 foo", 81, "FOO is no word of O100: write sub, call, if, while, do or repeat"),
    ("F100", "o100 if", 81, "O100 IF lacks its value in brackets"),
    ("F100", "o100 else", 81, "O100 ELSE has no O100 IF before it"),
    ("F100", "o100 endif", 81, "O100 ENDIF has no O100 IF before it"),
    ("F100", "o100 endsub", 81, "O100 ENDSUB has no O100 SUB before it"),
    ("F100", "o100 endwhile", 81, "O100 ENDWHILE has no O100 WHILE before it"),
    ("F100", "o100 return", 81, "O100 RETURN has no O100 SUB before it"),
    ("F100", "o100 sub 5", 81, "nothing may come behind O100 SUB"),
    ("F100", "o100 if [#<a> GT 0]", 74, "#<A> is not set above this line: set it, or correct the name"),
    ("F100", "o100 if [1/0]", 72, "O100 IF: the expression divides by zero"),
    ("F100 | o100 sub", "o200 sub", 81, "O200 SUB is inside another subroutine: write it above that one"),
    ("F100 | o100 sub | o100 endsub", "o100 call 5", 81, "O100 CALL takes values: put each one in its own brackets"),
    (
        "F100 | M30",
        "O1001 X5",
        203,
        "O1001X5 cannot start here: end the subprogram above with M99, use each number once, then send $X",
    ),
    ("", "$J=X5", 22, "F is missing: each jog needs its own"),
    ("", "$J=G91 X5", 22, "F is missing: each jog needs its own"),
    ("", "$J=X5 F100 S5", 36, "S5 is not for a jog"),
    ("", "$J=M3 X5 F100", 16, "M3 is not for a jog: it takes axis words, F, G20, G21, G53, G90 and G91"),
    ("", "$J=G0 X5 F100", 16, "G0 is not for a jog: it takes axis words, F, G20, G21, G53, G90 and G91"),
    ("", "$J=G92 X5 F100", 16, "G92 is not for a jog: it takes axis words, F, G20, G21, G53, G90 and G91"),
    ("", "$J=X1,5 F100", 1, "comma in X1,5: write a decimal point"),
    ("F100", ")", 1, "a remark is not closed: each parenthesis needs its other half"),
    ("F100", "G51 X0 P2 I3", 36, "I3 does not go with P2 in G51: write one of them"),
    ("F100", "M62 P1 Q2", 36, "Q2 is used by nothing in this line: take it out"),
    ("F100", "G5 X1 Z1 I1 J1 P1 Q1", 140, "Z1 does not go with G5: write it in a line of its own"),
    ("F100", "G1 X5+", 1, "no number behind X5+"),
    ("F100", "G1 X[*2]", 75, "no value in front of * in the brackets of X"),
    ("F100", "G1 Z[1+2] X[3", 75, "a bracket is not closed in X"),
    ("F100", "G1 XATAN[1]", 75, "ATAN in X takes two values: as in ATAN, y in brackets, /, x in brackets"),
    (
        "F100 | T5 M6 | G10 L1 P1 Z1",
        "G43 Z5",
        47,
        "T5 in the spindle is not in the table of tools: G10 L1 P5 Z<length> enters it",
    ),
    ("F100 | G68 R30", "G2 X9 Y2 I3", 33, "the radii of G2 differ at its ends: correct its centre or its end"),
    (
        "F100 | G10 L2 P1 X5 Y5",
        "G2 X10 Y0 I5 J2",
        33,
        "the radius of G2 is 5.385 mm at its start, 10.440 at its end. Write I5.000 J10.000, or I7.667 J2.000",
    ),
    ("F100 | G52 X0", "G43.1 Z-60000 G0 X1", 24, "G43.1 and G0 in one line: both want the axis words, write two lines"),
    ("F100", "(a ( X1", 1, "( begins no word"),
    ("F100", "G1 X1 G64 P0.1 R3", 36, "R3 belongs to an arc or a cycle, but G1 is active"),
    ("F100", "G81 G99 X1 Y1 Z-2 R1 F0", 22, "F0 is no feed: it must be above 0"),
    ("F100", "X1 Y2 Z3 I4 J5 K6", 36, "I4 belongs to an arc, but G0 is active: write G2 or G3"),
    ("F100 | #<w>=5", "G1 X[#<w>+2*#<H>]", 74, "#<H> is not set above this line: set it, or correct the name"),
    ("F100", "G0 X1 #<y>=#<z>", 74, "#<Z> is not set above this line: set it, or correct the name"),
    ("F100", "G1 X[2*[3+4]", 75, "a bracket is not closed in X"),
    ("F100", "G02 X5 Y5 R2", 34, "R2 is too small for G2: at least 3.536 mm (half the chord)"),
    (
        "F100",
        "G2 X10 Y10 J5",
        33,
        "the radius of G2 is 5.000 mm at its start, 11.180 at its end. Write I0.000 J10.000, or I5.000 J5.000",
    ),
    ("F100", "G17.5", 23, "G17.5 is not known: G17 has no fraction"),
    ("F100", "O", 2, "no number behind O"),
    ("F100", "O5 X3", 36, "O5 has to be alone in its line"),
    ("F100", "o5 repeat", 81, "O5 REPEAT lacks its value in brackets"),
    ("F100", "o5 while", 81, "O5 WHILE lacks its value in brackets"),
    ("F100", "o5 break", 81, "O5 BREAK is within no loop of this number"),
    ("F100", "o[2+1] sub", 81, "only a call may have a computed number"),
    ("F100", "o100 sub | endsub", 81, "nothing may come behind O100 SUB"),
    ("F100", "G55.1", 23, "G55.1 is not known: G55 has no fraction"),
    ("F100", "M30.5", 23, "M30.5 is not known: M words have whole numbers up to 255"),
    ("F100", "G53 X1 G92 Y1", 21, "G53 and G92 in one line: write one of them, or two lines"),
    ("F100", "G0 X1 S1 S2", 25, "S is twice in the line: S1 and S2"),
    ("F100", "I5", 36, "I5 belongs to an arc, but G0 is active: write G2 or G3"),
    ("F100", "R5", 36, "R5 belongs to an arc or a cycle, but G0 is active"),
    ("F100", "G92 E0", 26, "E0 is for the extruder of a 3-D printer: make the program for a mill"),
    ("F100", "P5", 36, "P5 is used by nothing in this line: take it out"),
    ("F100", "L5", 36, "L5 is used by nothing in this line: take it out"),
    ("F100", "O1000 G0 X5", 36, "O1000 has to be alone in its line"),
    ("F100", "G0 O5 X1", 36, "letter O in G0O5: write a 0"),
];

/// Rows in Grbl's dialect.
const ROWS_OF_GRBL: &[Row] = &[
    ("F100", "G1 X--1", 2, "two signs in X--1"),
    ("F100", "G1 X+-1", 2, "two signs in X+-1"),
    ("F100", "G1 X1O5", 20, "letter O in X1O5: write a 0"),
    ("F100", "G1 X1O", 2, "letter O in X1O: write a 0"),
    ("F100", "G1 X10-2.5", 1, "X10-2.5 is computed: write the result, such as X5"),
    ("F100", "G1 X#1", 2, "X is computed: Grbl's dialect takes numbers only ($900=1 computes)"),
    ("F100", "G1 X[1+2]", 2, "X is computed: Grbl's dialect takes numbers only ($900=1 computes)"),
    ("F100", "#1=5", 1, "#1 is a parameter: Grbl's dialect has none ($900=1 has)"),
    ("F100", "G81 X1 Z-1 R1", 20, "G81 is not in Grbl's dialect: $900=1 has it"),
    ("F100", "M6 T1", 20, "M6 is not in Grbl's dialect: $900=1 has it"),
    ("F100", "G43 H1", 20, "G43 is not in Grbl's dialect: $900=1 has it"),
    ("F100", "G59.1", 23, "G59.1 is not in Grbl's dialect: $900=1 has it"),
    ("F100", "D1", 20, "D1 has a letter that Grbl's dialect does not know ($900=1 may)"),
    ("F100", "Q5 X1", 20, "Q5 has a letter that Grbl's dialect does not know ($900=1 may)"),
    ("F100", "M7.5", 23, "M7.5 is not known: M words have whole numbers up to 255"),
    ("F100", "G54.1", 23, "G54.1 is not in Grbl's dialect: $900=1 has it"),
    ("F100", "T300", 38, "T300 is too high: tools go up to 255"),
    ("F100", "G2 I5", 26, "X and Y are missing in G2: where the arc ends"),
    ("F100", "G10 L10 P1 X0", 20, "L10 in G10 is not known: Grbl's dialect has L2 and L20"),
    ("F100", "G10 L2 P7 X0", 29, "P7 in G10 is no coordinate system: P1 to P6"),
    ("F100", "G43.1 X1", 37, "G43.1 takes Z and no other axis in Grbl's dialect"),
];

/// Returns the error number of a refused line and its sentence; `None` for an accepted line.
fn refusal(program: &Program, line: &str) -> Option<(u8, String)> {
    let (jog, line) = line.strip_prefix("$J=").map_or((false, line), |jog| (true, jog));
    let text = line.replace(' ', "").to_ascii_uppercase();
    let (mut interpreter, mut action, mut reason) = (program.interpreter.clone(), Action::NOTHING, Reason::new());
    let (text, dialect) = (text.as_bytes(), program.dialect);
    let checked = match jog {
        true => interpreter.check_jog_into(text, dialect, &mut action),
        false if dialect == Dialect::Grbl => interpreter.check_into(text, dialect, &mut action),
        false => {
            let ahead = interpreter.look_behind_end(text, false);
            match ahead.and_then(|()| interpreter.direct(text, &[], 1)) {
                Ok(Direction::Check) => match interpreter.check_into(text, dialect, &mut action) {
                    Ok(()) => Ok(()),
                    Err(error) => interpreter.direct_refused(text, &[], error).map(|_| ()),
                },
                other => other.map(|_| ()),
            }
        }
    };
    let error = checked.err()?;
    interpreter.explain(text, dialect, error, jog, &action, &mut reason);
    Some((error.code(), String::from_utf8(reason.to_vec()).expect("text")))
}

/// Returns a program that has run the lines of `setup`, which are separated by ` | `.
fn after(dialect: Dialect, setup: &str) -> Program {
    let mut program = Program::new(dialect);
    for line in setup.split(" | ").filter(|line| !line.is_empty()) {
        let text = line.replace(' ', "").to_ascii_uppercase();
        let looked = program.interpreter.look_behind_end(text.as_bytes(), false);
        let directed = looked.and_then(|()| program.interpreter.direct(text.as_bytes(), &[], 1));
        if dialect == Dialect::Grbl || directed == Ok(Direction::Check) {
            program.run(&text);
        } else if directed.expect(line) == Direction::Run {
            // The line calls an unknown subprogram, so the program waits.
            assert_eq!(program.interpreter.next_held(&mut HeldLine::new()), Ok(Held::End), "{line}");
        }
    }
    program
}

/// Returns the rows whose line is not refused as expected.
fn wrong(dialect: Dialect, rows: &[Row]) -> Vec<String> {
    let told = |(setup, line, code, text): &Row| {
        let refusal = refusal(&after(dialect, setup), line);
        let expected = Some((*code, (*text).to_owned()));
        (refusal != expected).then(|| format!("{setup} :: {line}: {refusal:?}, not {expected:?}"))
    };
    rows.iter().filter_map(told).collect()
}

#[test]
fn each_refusal_names_the_word() {
    for (dialect, rows) in [(Dialect::Oxmill, ROWS), (Dialect::Grbl, ROWS_OF_GRBL)] {
        assert_eq!(wrong(dialect, rows), [""; 0]);
    }
    assert!(ROWS.len() + ROWS_OF_GRBL.len() >= 150);
}

#[test]
fn a_wrong_sentence_is_found() {
    let rows =
        [("F100", "G1 X", 2, "no number behind Y"), ("F100", "G1 X", 1, "no number behind X"), ("", "G0 X1", 2, "")];
    assert_eq!(wrong(Dialect::Oxmill, &rows).len(), rows.len());
}

/// A sentence can name the least radius that is accepted. That radius is rounded up, so a line with it is accepted.
#[test]
fn the_least_radius_is_accepted() {
    for dialect in [Dialect::Oxmill, Dialect::Grbl] {
        let program = after(dialect, "F100");
        for ends in ["X10", "X10.0005", "X10.0001 Y0.0001", "X0.0001", "X5 Y5", "X7.0712 Y-7.0711", "Y-30000 X0.0003"] {
            let (_, reason) = refusal(&program, &format!("G2 {ends} R0")).expect("a refusal");
            let least =
                reason.strip_prefix("R0 is too small for G2: at least ").and_then(|text| text.split_once(" mm"));
            let (least, _) = least.unwrap_or_else(|| panic!("{ends}: {reason}"));
            assert_eq!(refusal(&program, &format!("G2 {ends} R{least}")), None, "{ends}: {reason}");
        }
    }
}

/// Each sentence fits into a `[MSG:...]`: at most 110 printable ASCII characters, without brackets. It differs from
/// the fixed text of every error.
#[test]
fn sentences_are_texts_of_a_message() {
    for (_, line, _, text) in ROWS.iter().chain(ROWS_OF_GRBL) {
        assert!(text.len() <= 110 && text.bytes().all(|byte| matches!(byte, b' '..=b'~')), "{line}: {text}");
        assert!(!text.contains(['[', ']']), "{line}: {text}");
        assert!(Error::ALL.iter().all(|error| error.text() != *text), "{line}: {text}");
    }
}

proptest! {
    /// Any refused line gets a sentence without brackets, shorter than 128 characters.
    #[test]
    fn any_text(line in "[GMXYZIJKRFPQLNO0-9.#<>=\\[\\],+*/a-z -]{0,60}", jog: bool, grbl: bool) {
        let mut program = after(Dialect::Oxmill, "F100 | #1=2");
        program.dialect = if grbl { Dialect::Grbl } else { Dialect::Oxmill };
        let line = if jog { format!("$J={line}") } else { line };
        if let Some((_, text)) = refusal(&program, &line) {
            prop_assert!(!text.contains(['[', ']']) && text.len() < 128, "{line}: {text}");
        }
    }

    /// An arc with one of the suggested pairs of I and J is accepted.
    #[test]
    fn suggested_centres_are_right(end in prop::array::uniform2(-30_000_000..30_000_000_i64), centre in prop::array::uniform2(-30_000_000..30_000_000_i64), small in 0..4_u32) {
        let mm = |value: i64| value as f64 / 1e3 / f64::from(10_u32.pow(small));
        let line = format!("G2 X{:.3} Y{:.3}", mm(end[0]), mm(end[1]));
        let program = after(Dialect::Oxmill, "F100");
        let Some((33, text)) = refusal(&program, &format!("{line} I{:.3} J{:.3}", mm(centre[0]), mm(centre[1]))) else { return Ok(()) };
        let Some((_, pairs)) = text.split_once("Write ") else { return Ok(()) };
        for pair in pairs.split(", or ") {
            let words = pair.replace(" with ", " ");
            prop_assert_eq!(refusal(&program, &format!("{line} {words}")), None, "{}", text);
        }
    }

    /// Any refused line made of common words gets a sentence.
    #[test]
    fn any_words(words in proptest::collection::vec(
        proptest::sample::select(vec![
            "G0", "G1", "G2", "G3", "G10", "G28", "G38.2", "G43", "G53", "G68", "G80", "G81", "G83", "G91", "G92", "G93",
            "M3", "M6", "M62", "M66", "X1", "Y-2", "Z3.5", "I1", "J0", "R2", "P1", "Q0", "L2", "H3", "F0", "F9", "O5", "X[1+",
            "#<A>", "T1", "S5", "K1", "X60000",
        ]),
        0..6,
    )) {
        let line = words.concat();
        if let Some((code, text)) = refusal(&after(Dialect::Oxmill, "F100"), &line) {
            prop_assert!(!text.is_empty(), "{line}: error:{code} has no sentence");
        }
    }
}
