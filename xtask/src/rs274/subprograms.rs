//! Random programs with subprograms in Fanuc's style. The subprograms follow the M30 of the main program, each after
//! its O number. M98 calls them, with or without a repeat count (L), also from subprograms. A subprogram shares the
//! parameters of its caller.

use oxmill_test_support::Random;

/// Maximum number of subprograms.
const MOST: u64 = 4;

/// Returns a program with 1 to [`MOST`] subprograms; the same seed gives the same program.
pub fn program(seed: u64) -> String {
    // Multiplied, so that neighbouring seeds give unlike programs.
    let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    let subprograms = 1 + random.below(MOST);
    let mut text = String::from("%\nG21 G90 G17 G94 G49 G40 G80 F300\n#1=2 #2=-1.5 #3=0.25\nG0 X1 Y0 Z0\n");
    for _ in 0..3 + random.below(6) {
        text += &line(&mut random, 0, subprograms);
    }
    text += "M30\n";
    for number in 1..=subprograms {
        text += &format!("O{}\n", label(number));
        for _ in 0..1 + random.below(5) {
            text += &line(&mut random, number, subprograms);
        }
        text += "M99\n";
    }
    text + "%\n"
}

/// Returns the O number of a subprogram, which is 100 times `number`. The second one has a leading zero.
fn label(number: u64) -> String {
    if number == 2 { "0200".into() } else { (100 * number).to_string() }
}

/// Returns a line of subprogram `number`, or of the main program if `number` is 0. It calls only subprograms with
/// higher numbers.
fn line(random: &mut Random, number: u64, subprograms: u64) -> String {
    let length = |random: &mut Random| format!("{}.{:03}", random.below(40), random.below(1000));
    match random.below(9) {
        0 | 1 if number < subprograms => {
            let called = number + 1 + random.below(subprograms - number);
            let repeats = if random.below(2) == 0 { format!(" L{}", 1 + random.below(3)) } else { String::new() };
            format!("M98 P{}{repeats}\n", label(called))
        }
        2 => format!("#{}=[#{} + {}]\n", 1 + random.below(3), 1 + random.below(3), length(random)),
        3 => format!("G91 G1 X[#1] Y-{}\nG90\n", length(random)),
        4 => format!("G0 X[#1 - {}] Z{}\n", length(random), length(random)),
        5 => format!("G91 G2 X{0} I[{0}/2] J0 F200\nG90\n", 1 + random.below(20)),
        6 => "G4 P0.1\n".into(),
        _ => format!("G1 X{} Y[#2 * 2] F{}\n", length(random), 100 + random.below(400)),
    }
}
