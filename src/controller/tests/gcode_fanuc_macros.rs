//! Tests of Fanuc's macro statements: WHILE, IF with THEN and GOTO, and M words that run macros.
#![cfg(feature = "full")]

use crate::subprogram_sender::{Sender, calling, fails, goes, with_macro};

#[test]
fn loops_of_fanuc() {
    let count = "#1=0\nWHILE [#1 LT 3] DO1\n#1=[#1+1]\nX#1\nEND1";
    goes(&calling(count), &[1, 1, 2, 3, 9]);
    // A loop in the main program works in the same way as a loop of O words: its lines are stored until its end has
    // come.
    goes(&format!("G0 X7\n{count}\nX9\nM30"), &[7, 1, 2, 3, 9]);
    goes("G0 X7\nN10 WHILE [1 EQ 2] DO 3\nX1\nN20 END 3\nX9\nM30", &[7, 9]);
    // Loops can be nested, and two loops with the same number can follow each other.
    let nested = "#1=0\nWHILE [#1 LT 2] DO1\n#2=0\nWHILE [#2 LT 2] DO2\nX[#1*10+#2]\n#2=[#2+1]\nEND2\n#1=[#1+1]\nEND1";
    goes(&calling(nested), &[1, 0, 1, 10, 11, 9]);
    goes(&calling(&format!("{count}\n{count}")), &[1, 1, 2, 3, 1, 2, 3, 9]);
    goes(&format!("{nested}\nG0 X9\nM30").replacen('#', "G0 X4\n#", 1), &[4, 0, 1, 10, 11, 9]);
    // M99 within a loop returns to the caller. The text of the subprogram does not end with that M99, but with the M99
    // after the loop.
    goes(&calling("WHILE [1] DO1\nX5\nM99\nEND1\nX6"), &[1, 5, 9]);
    fails("G0 X1\nEND1\nX2\nM30", &[81], &[1, 2]);
    fails("G0 X1\nWHILE [#1 LT 2] DO1\nX5\nEND2\nM30\n%\nX2", &[81], &[1, 2]);
    fails("G0 X1\nWHILE [1] DO1\n#1=[#1+1]\nEND1\nX2\nM30", &[202], &[1, 2]);
}

#[test]
fn conditions_of_fanuc() {
    let body = "IF [#1 EQ 0] THEN #1=5\nIF [#1 EQ 0] THEN #1=6\nN7 IF [#1 GT 4] THEN G0 X#1\nIF [0] THEN X8";
    goes(&format!("G0 X7\n{body}\nX9\nM30"), &[7, 5, 9]);
    goes(&calling(body), &[1, 5, 9]);
    goes(&format!("G0 X7\no1 repeat [2]\n{body}\no1 endrepeat\nX9\nM30"), &[7, 5, 5, 9]);
    fails("G0 X1\nIF [1/0] THEN X3\nX2\nM30", &[72], &[1, 2]);
    fails("G0 X1\nIF [1] THEN X3 X4\nX2\nM30", &[25], &[1, 2]);
    for line in ["IF [1] THEN", "IF [1] THEN M98 P1", "IF [1] THEN X5 M99", "IF [1] THEN M30", "IF [1] THEN o1 if [1]"]
    {
        let mut sender = Sender::new();
        sender.send_all(&format!("G0 X1\n{line}"));
        assert_eq!((sender.went, sender.errors.len(), sender.ends), (vec![1], 1, 0), "{line}");
    }
}

#[test]
fn jumps_of_fanuc() {
    goes(&calling("#1=0\nN10 #1=[#1+1]\nX#1\nIF [#1 LT 3] GOTO 10\nX8"), &[1, 1, 2, 3, 8, 9]);
    goes(&calling("GOTO 020\nX5\nN20 X6\nX7"), &[1, 6, 7, 9]);
    goes(&calling("#2=20\nGOTO #2\nX5\nN20 GOTO [#2+10]\nX6\nN30 X7"), &[1, 7, 9]);
    // GOTO goes to the next line with the number, not to the first one in the subprogram.
    goes(&calling("N5 #1=[#1+1]\nX#1\nIF [#1 GE 2] GOTO 6\nGOTO 5\nX4\nN5 X5\nN6 X6"), &[1, 1, 5, 6, 9]);
    // GOTO can lead out of loops, to the end of a pass, and to the beginning of a loop.
    goes(&calling("WHILE [1] DO1\n#1=[#1+1]\nX#1\nIF [#1 EQ 2] GOTO 50\nEND1\nN50 X8"), &[1, 1, 2, 8, 9]);
    let twice = "WHILE [1] DO1\nWHILE [1] DO2\nX4\nGOTO 50\nEND2\nEND1\nN50 X8\nWHILE [#1 LT 2] DO1\n#1=[#1+1]\nEND1";
    goes(&calling(twice), &[1, 4, 8, 9]);
    let pass = "WHILE [#1 LT 3] DO1\n#1=[#1+1]\nIF [#1 EQ 2] GOTO 5\nX#1\nN5 END1";
    goes(&calling(pass), &[1, 1, 3, 9]);
    let again = "N3 WHILE [#1 LT 3] DO1\n#1=[#1+1]\nIF [#1 EQ 2] GOTO 3\nX#1\nEND1";
    goes(&calling(again), &[1, 1, 3, 9]);
    goes(&calling("o7 repeat [3]\n#1=[#1+1]\nIF [#1 EQ 2] GOTO 5\nX#1\nN5 o7 endrepeat"), &[1, 1, 3, 9]);
    goes(&calling("o7 do\n#1=[#1+1]\nIF [#1 EQ 2] GOTO 5\nX#1\nN5 o7 while [#1 LT 3]"), &[1, 1, 3, 9]);
    // GOTO also works in three other places: in the part of a program that is stored because its subprogram comes
    // later, in a loop of the main program, and in a G65 call.
    goes("G0 X1\nM98 P1\nN5 #1=[#1+1]\nX#1\nIF [#1 LT 3] GOTO 5\nM30\nO1\nX9\nM99\n%", &[1, 9, 1, 2, 3]);
    goes("G0 X7\nWHILE [1] DO1\n#1=[#1+1]\nX#1\nIF [#1 LT 3] GOTO 5\no1 break\nN5 END1\nM30", &[7, 1, 2, 3]);
    goes("G0 X1\nG65 P1 A2\nX9\nM30\nO1\nIF [#1 EQ 2] GOTO 6\nX5\nN6 X6\nM99\n%", &[1, 6, 9]);
    // In a subprogram, GOTO reaches only lines of that subprogram. If the number is in the main program, in another
    // subprogram or nowhere, GOTO is an error.
    for body in ["GOTO 5", "GOTO 7", "GOTO 8", "GOTO 1.5", "GOTO -5"] {
        let file = format!("N8 G0 X1\nM98 P1\nN5 X9\nM30\nO1\n{body}\nM99\nO2\nN7 X7\nM99\n%");
        fails(&file, &[81, 203, 203, 203], &[1]);
    }
    // A jump into a loop or a condition is an error.
    fails(&calling("GOTO 5\nWHILE [1] DO1\nN5 X5\nEND1"), &[81], &[1, 5]);
    fails(&calling("o1 if [1]\nGOTO 5\no1 endif\nN5 X5\nM99\nX6"), &[203, 203], &[1, 5, 9]);
    fails(&calling("o1 if [1]\nGOTO 5\nX4\nN5 X5\no1 endif"), &[81], &[1, 5]);
    fails(&calling("N5 GOTO 5"), &[202], &[1]);
    fails("G0 X1\nGOTO 5\nX2\nN5 X3\nIF [1] GOTO 5\nM30", &[121, 121], &[1, 2, 3]);
}

/// G66 calls a subprogram after each line that moves an axis, with the same arguments.
#[test]
fn modal_calls() {
    let drill = "O1\nX[#1+50]\nM99\n%";
    // In the first case, the subprogram comes after the end of the program. So the lines from G66 on are stored until
    // the subprogram has come. In the second case, a subroutine is defined before G66.
    goes(
        &format!("G0 X1\nG66 P1 A2\nX3\nM8\nG4 P0\nY4\nG92 Y0\nX5\nG67\nX6\nM30\n{drill}"),
        &[1, 3, 52, 52, 52, 5, 52, 6],
    );
    goes("o1 sub\nX[#1+50]\no1 endsub\nG0 X1\nG66 P1 A2\nX3\nM8\nX5\nG67\nX6\nM30", &[1, 3, 52, 5, 52, 6]);
    // L repeats each call. G67 may have other words on its line.
    goes(
        &format!("G0 X1\nG66 P1 L2 A2\nX3\nG40 G67 G80 X7\nX8\nM30\n{drill}").replace("G80 X7", "X7"),
        &[1, 3, 52, 52, 7, 8],
    );
    // A move in the subprogram that G66 calls triggers no modal call. A move in a subprogram that is called by M98
    // triggers one.
    goes("G0 X1\nG66 P1\nM98 P2\nX7\nG67\nX9\nM30\nO1\nX2\nX3\nM99\nO2\nX4\nM99\n%", &[1, 4, 2, 3, 7, 2, 3, 9]);
    // Moves in a loop trigger the modal call, too. A new G66 replaces the first one. A G66 in a subprogram acts only
    // until that subprogram ends.
    goes(
        &format!("G0 X1\nG66 P1\no7 repeat [2]\nX3\no7 endrepeat\nG66 P1 A1\nX4\nM30\n{drill}"),
        &[1, 3, 50, 3, 50, 4, 51],
    );
    goes("G0 X1\nG65 P2\nX5\nM30\nO1\nX50\nM99\nO2\nG66 P1\nX4\nM99\n%", &[1, 4, 50, 5]);
    // The end of the program ends the modal call, too.
    goes(&format!("G0 X1\nG66 P1\nX3\nM30\n{drill}\nG0 X4"), &[1, 3, 50, 4]);
    fails(&format!("G0 X1\nG66 P1 A#5\nX3\nM30\n{drill}"), &[121], &[1, 3]);
    fails("G0 X1\nG66 A1\nX3\nM30", &[28], &[1, 3]);
    // Letters in a message or in the name of a function are not axis words, so they trigger no modal call.
    goes(&format!("G0 X1\nG66 P1\nX3\n(MSG, All X)\n#5=ABS[#4]\nX5\nM30\n{drill}"), &[1, 3, 50, 5, 50]);
    // The modal call ends with the subprogram O2 that contains its G66. The next subprogram, O3, runs without it.
    goes("G0 X1\nG65 P2\nG65 P3\nM30\nO1\nX50\nM99\nO2\nG66 P1\nX4\nM99\nO3\nX7\nM99\n%", &[1, 4, 50, 7]);
    // The move and the G67 may follow a condition. An M98 on the line of a move is run after the modal call.
    goes(&format!("G0 X1\nG66 P1\nIF [1] THEN X3\nIF [1] THEN G67\nX5\nM30\n{drill}"), &[1, 3, 50, 5]);
    let two = "o1 sub\nX50\no1 endsub\no2 sub\nM8\no2 endsub";
    goes(&format!("{two}\nG0 X1\nG66 P1\nX3 M98 P2\nG67\nX5\nM30"), &[1, 3, 50, 5]);
    // A G66 within the subprogram that G66 calls would replace the outer one, so it is an error.
    fails("G0 X1\nG66 P1\nX3\nM30\nO1\nX50\nG66 P1\nM99\n%", &[82], &[1, 3, 50]);
    // A modal call ends with its program, even if the program has no M30 and ends with `%`.
    goes(&format!("{two}\nG0 X1\nG66 P1\nX3\n%\nX4\nM30"), &[1, 3, 50, 4]);
    fails(&format!("{two}\nG0 X1\nG66 P1\nX3\nG66 P2 A#5\nX4\nM30"), &[121], &[1, 3, 50, 4]);
    // A refused line ends the modal call, so that nothing is called where the program did not mean to.
    fails("o1 sub\nX50\no1 endsub\nG0 X1\nG66 P1\nX3\nX4 X5\nX6\nM30", &[25], &[1, 3, 50, 6]);
}

/// M10, M11 and M100 to M199 run a macro with their number, if there is one.
#[test]
fn m_words_of_macros() {
    let macros = ["O10SUB", "G0X3", "O10ENDSUB", "O150SUB", "X#1", "X#2", "O150ENDSUB"];
    let send = |text: &str| {
        let mut sender = with_macro(&macros);
        sender.send_all(text);
        (sender.went, sender.errors)
    };
    assert_eq!(send("G0 X1\nM10\nX2\nM150 P7 Q[2*4]\nN5 M150P6\nM30"), (vec![1, 3, 2, 7, 8, 6, 0], vec![]));
    assert_eq!(send("G0 X1\no1 repeat [2]\nM010\no1 endrepeat\nM30"), (vec![1, 3, 3], vec![]));
    assert_eq!(send(&calling("M10\nM150 P5 Q6")), (vec![1, 3, 5, 6, 9], vec![]));
    // If there is no macro with the number of an M word, the M word is refused. An M word with other words on its line
    // is refused, too. A subroutine of the program is not called in place of a macro, even if it has that number.
    for (line, error) in [("M11", 20), ("M151", 20), ("M10.1", 23), ("M10 X5", 36), ("X5 M10", 20), ("M150 Q2 P1", 36)]
    {
        assert_eq!(send(&format!("G0 X1\n{line}\nX2\nM30")), (vec![1, 2], vec![error]), "{line}");
    }
    assert_eq!(send("o11 sub\nG0 X5\no11 endsub\nM11\nG0 X2\nM30"), (vec![2], vec![20]));
    assert_eq!(send("o10 sub\nG0 X5\no10 endsub\nM10\no10 call\nM30"), (vec![3, 5], vec![]));
}
