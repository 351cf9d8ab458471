//! Decodes Thumb-2 instructions as far as needed here: their length, their branch targets, and their cycles on a
//! Cortex-M4F. Results of arithmetic are not computed.
//!
//! Cycles follow the table of ARM DDI 0439 (3.3.1) for memory without wait states. The table leaves some costs open.
//! These values are used for them:
//!
//! * a taken branch: 2 on top of its own cycle
//! * a division: 7 (of 2 to 12)
//! * a load right after another memory access: 1 instead of 2, unless its address is the result of that access
//! * reading a floating-point result in the next instruction: 1 more

/// Effect of an instruction on control flow and memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Integer arithmetic and everything else of one cycle.
    Plain,
    Load {
        /// Register that holds the address.
        base: u8,
        /// Register that is loaded.
        to: u8,
    },
    /// Stores one register.
    Store {
        /// `true` if the address is the sum of two registers, which costs one more cycle.
        indexed: bool,
    },
    /// Loads or stores this many words.
    Multiple(u32),
    /// `dsb`, `dmb` or `isb`.
    Barrier,
    /// `sdiv` or `udiv`.
    Divide,
    /// A floating-point instruction that does not access memory.
    Float(Float),
    /// A branch to a fixed address.
    Branch {
        /// Target address.
        target: u32,
        /// `true` if the instruction itself is unconditional; an IT before it can still make it conditional.
        always: bool,
    },
    /// A call of a fixed address.
    Call(u32),
    /// A call of an address in a register.
    CallRegister,
    /// A jump to an address in a register or in memory.
    JumpRegister,
    /// A jump by a table that follows the instruction (`tbb`, `tbh`).
    Table,
    /// A return to the caller, after loading this many words from the stack.
    Return(u32),
    /// IT: the next instructions are conditional.
    If,
    /// `udf`, which is not meant to be executed.
    Undefined,
}

/// A floating-point instruction and the single-precision registers it reads and writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Float {
    /// Cycles of the instruction, without waiting for its operands.
    pub cycles: u32,
    /// Numbers of the registers that it reads, at most two; `None` in the other places.
    pub reads: [Option<u8>; 2],
    /// Number of the register that it writes; `None` if it writes none.
    pub writes: Option<u8>,
}

/// Size and class of a decoded instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Instruction {
    /// Size, in bytes: 2 or 4.
    pub size: u32,
    /// Class of the instruction, which decides its cycles and where execution continues.
    pub kind: Kind,
}

const PC: u8 = 15;
const SP: u8 = 13;
const LR: u8 = 14;

/// Returns the lowest `bits` bits of `value` as a signed number.
fn signed(value: u32, bits: u32) -> i32 {
    let unused = 32 - bits;
    (value << unused) as i32 >> unused
}

fn field(half: u32, lowest: u32, bits: u32) -> u32 {
    half >> lowest & ((1 << bits) - 1)
}

/// Returns the number of bytes by which an instruction lowers the stack pointer; `None` for another instruction.
/// Source: SUB (SP minus immediate), encodings T1 to T3, ARMv7-M Architecture Reference Manual, A7.7.176.
pub fn frame(first: u16, second: u16) -> Option<u32> {
    let (one, two) = (u32::from(first), u32::from(second));
    let imm12 = field(one, 10, 1) << 11 | field(two, 12, 3) << 8 | field(two, 0, 8);
    match (one & 0xFBFF, two & 0x8F00) {
        _ if one & 0xFF80 == 0xB080 => Some(field(one, 0, 7) * 4),
        (0xF1AD, 0x0D00) if imm12 >> 10 == 0 => Some(imm12 & 0xFF),
        (0xF1AD, 0x0D00) => Some((0x80 | imm12 & 0x7F).rotate_right(imm12 >> 7)),
        (0xF2AD, 0x0D00) => Some(imm12),
        _ => None,
    }
}

/// Decodes the instruction at `address` from its first half word and the next one.
pub fn decode(address: u32, first: u16, second: u16) -> Instruction {
    let (a, b) = (u32::from(first), u32::from(second));
    if a >> 11 < 0b11101 {
        Instruction { size: 2, kind: narrow(address, a) }
    } else {
        Instruction { size: 4, kind: wide(address, a, b) }
    }
}

fn narrow(address: u32, a: u32) -> Kind {
    let low = |at| field(a, at, 3) as u8;
    let to = |offset: i32| address.wrapping_add(4).wrapping_add_signed(offset);
    match a >> 8 {
        0x47 => match (a & 0x80 != 0, field(a, 3, 4) as u8) {
            (true, _) => Kind::CallRegister,
            (false, LR) => Kind::Return(0),
            (false, _) => Kind::JumpRegister,
        },
        0x44 | 0x46 if (a & 7 | a >> 4 & 8) as u8 == PC => Kind::JumpRegister,
        0x48..=0x4F => Kind::Load { base: PC, to: field(a, 8, 3) as u8 },
        0x50..=0x55 => Kind::Store { indexed: true },
        0x56..=0x5F => Kind::Load { base: low(3), to: low(0) },
        0x60..=0x67 | 0x70..=0x77 | 0x80..=0x87 => Kind::Store { indexed: false },
        0x68..=0x6F | 0x78..=0x7F | 0x88..=0x8F => Kind::Load { base: low(3), to: low(0) },
        0x90..=0x97 => Kind::Store { indexed: false },
        0x98..=0x9F => Kind::Load { base: SP, to: field(a, 8, 3) as u8 },
        0xB4 | 0xB5 => Kind::Multiple(field(a, 0, 9).count_ones()),
        0xBC => Kind::Multiple(field(a, 0, 8).count_ones()),
        0xBD => Kind::Return(field(a, 0, 9).count_ones()),
        0xB1 | 0xB3 | 0xB9 | 0xBB => {
            Kind::Branch { target: to((field(a, 9, 1) << 6 | field(a, 3, 5) << 1) as i32), always: false }
        }
        0xBF if a & 0xF != 0 => Kind::If,
        0xC0..=0xCF => Kind::Multiple(field(a, 0, 8).count_ones()),
        0xD0..=0xDD => Kind::Branch { target: to(signed(a & 0xFF, 8) << 1), always: false },
        0xDE => Kind::Undefined,
        0xE0..=0xE7 => Kind::Branch { target: to(signed(a & 0x7FF, 11) << 1), always: true },
        _ => Kind::Plain,
    }
}

fn wide(address: u32, a: u32, b: u32) -> Kind {
    let rt = field(b, 12, 4) as u8;
    let rn = field(a, 0, 4) as u8;
    let load = a & 0x10 != 0;
    if a & 0xFE40 == 0xE800 {
        return multiple(load && b & 1 << PC != 0, (b & 0xFFFF).count_ones());
    }
    if a & 0xFE40 == 0xE840 {
        return match (a & 0xFFF0, b >> 4 & 0xF) {
            (0xE8D0, 0 | 1) => Kind::Table,
            // Exclusive accesses (`ldrex`, `strex`).
            (0xE850, _) | (0xE8D0, _) => Kind::Load { base: rn, to: rt },
            (0xE840, _) | (0xE8C0, _) => Kind::Store { indexed: false },
            _ => Kind::Multiple(2),
        };
    }
    if a & 0xEC00 == 0xEC00 {
        return coprocessor(a, b);
    }
    if a & 0xF800 == 0xF000 && b & 0x8000 != 0 {
        return branch(address, a, b);
    }
    if a & 0xFE00 == 0xF800 {
        if !load {
            return Kind::Store { indexed: a & 0x80 == 0 && b & 0xFC0 == 0 };
        }
        return match (rt, a & 0x60 == 0x40, rn) {
            (PC, true, SP) if b & 0xFFF == 0xB04 => Kind::Return(1),
            (PC, true, _) => Kind::JumpRegister,
            // Prefetch hints (`pld`, `pli`).
            (PC, false, _) => Kind::Plain,
            _ => Kind::Load { base: rn, to: rt },
        };
    }
    if (a & 0xFFF0 == 0xFB90 || a & 0xFFF0 == 0xFBB0) && b & 0xF0 == 0xF0 {
        return Kind::Divide;
    }
    Kind::Plain
}

fn multiple(returns: bool, words: u32) -> Kind {
    if returns { Kind::Return(words) } else { Kind::Multiple(words) }
}

fn branch(address: u32, a: u32, b: u32) -> Kind {
    let to = |offset: i32| address.wrapping_add(4).wrapping_add_signed(offset);
    let sign = field(a, 10, 1);
    let (j1, j2) = (field(b, 13, 1), field(b, 11, 1));
    let far = || {
        // Where the sign bit is 0, the two J bits are stored inverted: I1 = NOT(J1 XOR S) (ARMv7-M, A7.7.12).
        let (i1, i2) = (!(j1 ^ sign) & 1, !(j2 ^ sign) & 1);
        to(signed(sign << 24 | i1 << 23 | i2 << 22 | field(a, 0, 10) << 12 | field(b, 0, 11) << 1, 25))
    };
    match b & 0xD000 {
        0xD000 => Kind::Call(far()),
        0x9000 => Kind::Branch { target: far(), always: true },
        0x8000 if field(a, 6, 4) < 14 => {
            let offset = sign << 20 | j2 << 19 | j1 << 18 | field(a, 0, 6) << 12 | field(b, 0, 11) << 1;
            Kind::Branch { target: to(signed(offset, 21)), always: false }
        }
        0x8000 if a == 0xF3BF && b & 0xFF00 == 0x8F00 => Kind::Barrier,
        0x8000 if a & 0xFFF0 == 0xF7F0 && b & 0xF000 == 0xA000 => Kind::Undefined,
        _ => Kind::Plain,
    }
}

fn coprocessor(a: u32, b: u32) -> Kind {
    let double = field(b, 8, 4) == 11;
    let register = |high: u32, low: u32| if double { None } else { Some((high << 1 | low) as u8) };
    let d = register(field(b, 12, 4), field(a, 6, 1));
    let n = register(field(a, 0, 4), field(b, 7, 1));
    let m = register(field(b, 0, 4), field(b, 5, 1));
    let load = a & 0x10 != 0;
    if a & 0xFE00 == 0xEC00 {
        let words = if double { 2 } else { 1 };
        return match (a & 0x1A0, load) {
            // Transfers of two registers between core and floating-point unit.
            (0x000 | 0x040, _) if a & 0x1E0 == 0x040 => Kind::Plain,
            (0x100 | 0x180, true) if words == 1 => Kind::Load { base: field(a, 0, 4) as u8, to: u8::MAX },
            (0x100 | 0x180, false) if words == 1 => Kind::Store { indexed: false },
            (0x100 | 0x180, _) => Kind::Multiple(words),
            _ => Kind::Multiple(b & 0xFF),
        };
    }
    if b & 0x10 != 0 {
        // Transfers between core and floating-point unit; transfers of the status register cause no delay.
        let moved = if a & 0xFFE0 == 0xEE00 { n } else { None };
        let (reads, writes) = if load { (moved, None) } else { (None, moved) };
        return Kind::Float(Float { cycles: 1, reads: [reads, None], writes });
    }
    let (cycles, reads, writes) = match (a >> 4 & 0xB, a & 0xF, b >> 6 & 3) {
        (0 | 1 | 9 | 10, _, _) => (3, [n, m], d),
        (8, _, _) => (14, [n, m], d),
        (11, 1, 3) => (14, [m, None], d),
        (11, 4 | 5, _) => (1, [d, m], None),
        (11, _, _) if b & 0x40 != 0 => (1, [m, None], d),
        (11, _, _) => (1, [None, None], d),
        _ => (1, [n, m], d),
    };
    Kind::Float(Float { cycles, reads, writes })
}

/// Counts instructions and cycles along an execution path.
#[derive(Clone, Copy, Debug, Default)]
pub struct Meter {
    before: Option<Kind>,
    pub instructions: u64,
    pub cycles: u64,
}

impl Meter {
    /// Adds an executed instruction to the counts. `taken`: `true` if it has branched, so that the next executed
    /// instruction is not the following one in memory.
    pub fn add(&mut self, kind: Kind, taken: bool) {
        let mut cycles = match kind {
            Kind::Load { base, .. } => match self.before {
                Some(Kind::Load { to, .. }) if to != base => 1,
                Some(Kind::Store { .. } | Kind::Multiple(_)) => 1,
                _ => 2,
            },
            Kind::Store { indexed } => 1 + u32::from(indexed),
            Kind::Multiple(words) | Kind::Return(words) => 1 + words,
            Kind::Barrier => 3,
            Kind::Divide => 7,
            Kind::Table => 2,
            Kind::Float(float) => float.cycles,
            _ => 1,
        };
        if let (Some(Kind::Float(before)), Kind::Float(now)) = (self.before, kind)
            && before.writes.is_some_and(|register| now.reads.contains(&Some(register)))
        {
            cycles += 1;
        }
        if taken {
            cycles += 2;
        }
        self.before = if taken { None } else { Some(kind) };
        self.instructions += 1;
        self.cycles += u64::from(cycles);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(first: u16, second: u16) -> Kind {
        decode(0x1000, first, second).kind
    }

    /// Encodings as produced by an assembler.
    #[test]
    fn branches_lead_where_the_assembler_says() {
        let branch = |target, always| Kind::Branch { target, always };
        assert_eq!(kind(0xE7FE, 0), branch(0x1000, true)); // b .
        assert_eq!(kind(0xD0FE, 0), branch(0x1000, false)); // beq .
        assert_eq!(kind(0xB108, 0), branch(0x1006, false)); // cbz r0, .+6
        assert_eq!(kind(0xF7FF, 0xBFFE), branch(0x1000, true)); // b.w .
        assert_eq!(kind(0xF43F, 0xAFFE), branch(0x1000, false)); // beq.w .
        assert_eq!(kind(0xF000, 0xF800), Kind::Call(0x1004)); // bl .+4
        assert_eq!(kind(0xF7FF, 0xFFFE), Kind::Call(0x1000)); // bl .
        assert_eq!(kind(0xF000, 0xD800), Kind::Call(0x0080_1004)); // bl .+0x800004
        assert_eq!(kind(0x4780, 0), Kind::CallRegister); // blx r0
        assert_eq!(kind(0x4718, 0), Kind::JumpRegister); // bx r3
        assert_eq!(kind(0x4770, 0), Kind::Return(0)); // bx lr
        assert_eq!(kind(0xBD10, 0), Kind::Return(2)); // pop {r4, pc}
        assert_eq!(kind(0xE8BD, 0x81F0), Kind::Return(6)); // pop.w {r4-r8, pc}
        assert_eq!(kind(0xF85D, 0xFB04), Kind::Return(1)); // ldr pc, [sp], #4
        assert_eq!(kind(0xE8DF, 0xF000), Kind::Table); // tbb [pc, r0]
    }

    #[test]
    fn memory_and_arithmetic() {
        assert_eq!(kind(0x6848, 0), Kind::Load { base: 1, to: 0 }); // ldr r0, [r1, #4]
        assert_eq!(kind(0xF8D8, 0x0008), Kind::Load { base: 8, to: 0 }); // ldr.w r0, [r8, #8]
        assert_eq!(kind(0xF848, 0x1020), Kind::Store { indexed: true }); // str.w r1, [r8, r0, lsl #2]
        assert_eq!(kind(0xF8C8, 0x1020), Kind::Store { indexed: false }); // str.w r1, [r8, #0x20]
        assert_eq!(kind(0xE9D0, 0x1204), Kind::Multiple(2)); // ldrd r1, r2, [r0, #16]
        assert_eq!(kind(0xB5F0, 0), Kind::Multiple(5)); // push {r4-r7, lr}
        assert_eq!(kind(0xFBB0, 0xF0F1), Kind::Divide); // udiv r0, r0, r1
        assert_eq!(kind(0xFB00, 0xF001), Kind::Plain); // mul r0, r0, r1
        assert_eq!(kind(0xF3EF, 0x8011), Kind::Plain); // mrs r0, basepri
        assert_eq!(kind(0xF3BF, 0x8F4F), Kind::Barrier); // dsb
        let float = |cycles, reads, writes| Kind::Float(Float { cycles, reads, writes });
        assert_eq!(kind(0xEE30, 0x0A81), float(1, [Some(1), Some(2)], Some(0))); // vadd.f32 s0, s1, s2
        assert_eq!(kind(0xEEB1, 0x0AC0), float(14, [Some(0), None], Some(0))); // vsqrt.f32 s0, s0
        assert_eq!(kind(0xEE80, 0x0A20), float(14, [Some(0), Some(1)], Some(0))); // vdiv.f32 s0, s0, s1
        assert_eq!(kind(0xED90, 0x0A01), Kind::Load { base: 0, to: u8::MAX }); // vldr s0, [r0, #4]
        assert_eq!(kind(0xED2D, 0x8B02), Kind::Multiple(2)); // vpush {d8}
    }

    #[test]
    fn frames() {
        assert_eq!(frame(0xB086, 0), Some(24)); // sub sp, #24
        assert_eq!(frame(0xF5AD, 0x5DC8), Some(6400)); // sub.w sp, sp, #6400
        assert_eq!(frame(0xF6AD, 0x2DBC), Some(0xABC)); // subw sp, sp, #0xABC
        assert_eq!(frame(0xB006, 0), None); // add sp, #24
        assert_eq!(frame(0xF1A0, 0x0D08), None); // sub.w sp, r0, #8
    }

    #[test]
    fn cycles_add_up() {
        let mut meter = Meter::default();
        meter.add(Kind::Load { base: 0, to: 1 }, false); // 2
        meter.add(Kind::Load { base: 0, to: 2 }, false); // 1, pipelined
        meter.add(Kind::Load { base: 2, to: 3 }, false); // 2, waits for its address
        meter.add(Kind::Plain, false); // 1
        meter.add(Kind::Branch { target: 0, always: true }, true); // 3
        assert_eq!((meter.instructions, meter.cycles), (5, 9));
    }
}
