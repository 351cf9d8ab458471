//! Checks on the linked image that the step interrupt cannot reach a panic, software floating point or software
//! division. The source does not show all of them: the compiler adds a panic if it cannot prove that an index is in
//! range, and software division if code divides a `u64`. Only this check shows such cases.
//!
//! The check follows every branch and call from the interrupt handler on. The target of a call through a register
//! cannot be read from the code. So each function that makes such calls must be listed by name, with all possible
//! targets.

use crate::Failure;
use crate::elf::{self, Elf, Function};
use crate::thumb::{Instruction, Kind, decode};
use object::read::elf::ElfSymbol32;
use object::{LittleEndian, Object, ObjectSymbol};
use std::collections::{BTreeMap, BTreeSet};

/// Parts of function names, each with what a function of this name does. The step interrupt must not reach these
/// functions.
const FORBIDDEN: [(&str, &str); 18] = [
    ("panic", "a panic"),
    ("unwrap_failed", "a panic"),
    ("expect_failed", "a panic"),
    ("slice_index", "a panic"),
    ("__aeabi_d", "a double in software"),
    ("__aeabi_f", "a float in software"),
    ("2d", "a double in software"),
    ("df3", "a double in software"),
    ("df2", "a double in software"),
    ("sf3", "a float in software"),
    ("dfsi", "a double in software"),
    ("dfdi", "a double in software"),
    ("divmod", "a division in software"),
    ("__udiv", "a division in software"),
    ("__div", "a division in software"),
    ("__mod", "a division in software"),
    ("__umod", "a division in software"),
    ("div_rem", "a division in software"),
];

/// A function that may call addresses in registers, and the possible targets.
pub struct Allowed {
    /// Part of the name of the function, demangled.
    pub function: &'static str,
    /// Parts of the names of all functions that such a call can lead to. The check follows these functions, too.
    pub targets: &'static [&'static str],
}

struct Program<'a> {
    elf: &'a Elf<'a>,
    /// Functions by address.
    functions: BTreeMap<u32, Function<'a>>,
    /// Addresses at which code (`true`) or data (`false`) begins.
    marks: BTreeMap<u32, bool>,
}

impl<'a> Program<'a> {
    fn new(elf: &'a Elf<'a>) -> Program<'a> {
        let functions = elf::functions(elf).map(|function| (function.address, function)).collect();
        let mark = |symbol: ElfSymbol32<'_, '_, LittleEndian>| {
            // ELF for the Arm architecture, 5.5.5: mapping symbols, with or without a suffix.
            match symbol.name().ok()?.split('.').next()? {
                "$t" => Some((symbol.address() as u32, true)),
                "$d" => Some((symbol.address() as u32, false)),
                _ => None,
            }
        };
        Program { elf, functions, marks: elf.symbols().filter_map(mark).collect() }
    }

    fn instruction(&self, address: u32) -> Option<Instruction> {
        let second = elf::half(self.elf, address + 2).unwrap_or(0);
        Some(decode(address, elf::half(self.elf, address)?, second))
    }

    /// Returns the function that contains an address, and the function's end.
    fn function(&self, address: u32) -> Option<(&Function<'a>, u32)> {
        let (start, symbol) = self.functions.range(..=address).next_back()?;
        let next = self.functions.range(start + 1..).next().map_or(u32::MAX, |(next, _)| *next);
        let end = if symbol.size > 0 { start + symbol.size } else { next };
        (address < end).then_some((symbol, end))
    }

    fn is_data(&self, address: u32) -> bool {
        self.marks.range(..=address).next_back().is_some_and(|(_, code)| !code)
    }
}

/// Returns the names of all functions that `handler` can reach. Fails if one of them is forbidden, or if a function
/// that is not in `allowed` calls an address in a register.
pub fn check(elf: &Elf<'_>, handler: &str, allowed: &[Allowed]) -> Result<Vec<String>, Failure> {
    let program = Program::new(elf);
    let root = program.functions.values().find(|f| f.name == handler);
    let root = root.ok_or_else(|| format!("the image has no handler `{handler}`"))?.address;
    let mut found: BTreeMap<u32, u32> = BTreeMap::from([(root, root)]);
    let mut open = vec![root];
    let mut faults = BTreeSet::new();
    while let Some(start) = open.pop() {
        let Some((symbol, end)) = program.function(start) else {
            faults.insert(format!(
                "{:#010x}, called from {}, is in no function",
                start,
                name_at(&program, found[&start])
            ));
            continue;
        };
        let name = demangled(symbol.name);
        if let Some((_, what)) = FORBIDDEN.iter().find(|(part, _)| forbids(part, &name)) {
            faults.insert(format!("{what}: {name}, called from {}", name_at(&program, found[&start])));
            continue;
        }
        let mut reach = |target: u32| {
            if let std::collections::btree_map::Entry::Vacant(new) = found.entry(target) {
                new.insert(start);
                open.push(target);
            }
        };
        let mut address = symbol.address;
        while address < end {
            if program.is_data(address) {
                address += 2;
                continue;
            }
            let Some(instruction) = program.instruction(address) else { break };
            match instruction.kind {
                Kind::Call(target) | Kind::Branch { target, .. } if !(symbol.address..end).contains(&target) => {
                    reach(program.function(target).map_or(target, |(function, _)| function.address));
                }
                Kind::CallRegister | Kind::JumpRegister => {
                    match allowed.iter().find(|known| name.contains(known.function)) {
                        Some(known) => {
                            for part in known.targets {
                                let mut targets =
                                    program.functions.values().filter(|f| demangled(f.name).contains(part)).peekable();
                                if targets.peek().is_none() {
                                    faults.insert(format!("{part}, which {name} may call, is not in the image"));
                                }
                                targets.for_each(|f| reach(f.address));
                            }
                        }
                        None => {
                            faults.insert(format!("a call of an unknown function at {address:#010x} in {name}"));
                        }
                    }
                }
                _ => {}
            }
            address += instruction.size;
        }
    }
    if faults.is_empty() {
        Ok(found.keys().map(|address| name_at(&program, *address)).collect())
    } else {
        let list: Vec<String> = faults.into_iter().collect();
        Err(format!("`{handler}` reaches what a step interrupt must not:\n  {}", list.join("\n  ")))
    }
}

/// Returns `true` if `part`, an entry of [`FORBIDDEN`], forbids the function `name`. Some parts, such as `2d`, stand
/// for runtime routines of the compiler, such as `__aeabi_f2d`. The name of such a routine has no `::`, so these parts
/// match no Rust path.
fn forbids(part: &str, name: &str) -> bool {
    let routine = !name.contains("::");
    match part {
        "2d" | "df3" | "df2" | "sf3" => routine && name.starts_with("__") && name.ends_with(part),
        "dfsi" | "dfdi" => routine && name.contains(part),
        "__aeabi_f" => routine && name.starts_with(part),
        _ => name.contains(part),
    }
}

fn name_at(program: &Program<'_>, address: u32) -> String {
    program.function(address).map_or_else(|| format!("{address:#010x}"), |(symbol, _)| demangled(symbol.name))
}

/// Returns a name of the symbol table as a Rust path, without its hash.
pub fn demangled(name: &str) -> String {
    format!("{:#}", rustc_demangle::demangle(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(file: &[u8], handler: &str, allowed: &[Allowed]) -> Result<Vec<String>, Failure> {
        super::check(&elf::parse(file)?, handler, allowed)
    }

    /// A function: its name, and its code as half words.
    type Function = (&'static str, Vec<u16>);

    const ORIGIN: u32 = 0x1000;
    /// `bx lr`.
    const RETURN: u16 = 0x4770;

    /// Returns the call instruction `bl` at half word `from` of the program. It calls the function at half word `to`.
    fn call(from: usize, to: usize) -> [u16; 2] {
        let offset = (to as i32 - from as i32 - 2) * 2;
        let bits = offset as u32;
        // For such a near target, the two J bits in the second half word of a BL are 1, for either sign of the offset.
        [0xF000 | (bits >> 31 << 10 | bits >> 12 & 0x3FF) as u16, 0xF800 | (bits >> 1 & 0x7FF) as u16]
    }

    /// Returns an ELF file with these functions one after the other, and a symbol for each.
    fn elf(functions: &[Function]) -> Vec<u8> {
        let (mut code, mut symbols) = (Vec::new(), Vec::new());
        for (name, halves) in functions {
            symbols.push((*name, ORIGIN + code.len() as u32, halves.len() as u32 * 2));
            code.extend(halves.iter().flat_map(|half| half.to_le_bytes()));
        }
        elf::file(&[(ORIGIN, &code)], &symbols)
    }

    /// Returns a handler that calls a helper, which calls `last`.
    fn chain(last: &'static str) -> Vec<u8> {
        let [a, b] = call(0, 3);
        let [c, d] = call(3, 6);
        elf(&[("TIM5", vec![a, b, RETURN]), ("helper", vec![c, d, RETURN]), (last, vec![RETURN])])
    }

    #[test]
    fn what_is_called_by_what_is_called_is_found() {
        assert_eq!(check(&chain("harmless"), "TIM5", &[]), Ok(vec!["TIM5".into(), "helper".into(), "harmless".into()]));
        for (name, what) in [
            ("_ZN4core9panicking5panic17h0123456789abcdefE", "a panic"),
            ("__aeabi_dadd", "a double in software"),
            ("__adddf3", "a double in software"),
            ("__extendsfdf2", "a double in software"),
            ("__aeabi_fmul", "a float in software"),
            ("__aeabi_uldivmod", "a division in software"),
            ("__udivmoddi4", "a division in software"),
            (
                "_ZN17compiler_builtins3int19specialized_div_rem11u64_div_rem17h0123456789abcdefE",
                "a division in software",
            ),
        ] {
            let found = check(&chain(name), "TIM5", &[]).unwrap_err();
            assert!(found.contains(what) && found.contains("called from helper"), "{name}: {found}");
        }
    }

    #[test]
    fn what_nobody_calls_does_no_harm() {
        let file = elf(&[("TIM5", vec![RETURN]), ("__aeabi_ddiv", vec![RETURN])]);
        assert_eq!(check(&file, "TIM5", &[]), Ok(vec!["TIM5".into()]));
        assert!(check(&file, "TIM3", &[]).is_err());
    }

    #[test]
    fn jumps_out_of_a_function_count_as_calls() {
        // b.w to the second function: a tail call.
        let file = elf(&[("TIM5", vec![0xF000, 0xB800]), ("__aeabi_ddiv", vec![RETURN])]);
        assert!(check(&file, "TIM5", &[]).unwrap_err().contains("__aeabi_ddiv"));
    }

    #[test]
    fn a_call_of_an_unknown_address_must_be_allowed_and_its_targets_are_walked() {
        // blx r3; bx lr
        let wakes = |target| elf(&[("TIM5", vec![0x4798, RETURN]), (target, vec![RETURN])]);
        let known = [Allowed { function: "TIM5", targets: &["wake"] }];
        assert!(check(&wakes("wake"), "TIM5", &[]).unwrap_err().contains("unknown function at 0x00001000 in TIM5"));
        assert_eq!(check(&wakes("wake"), "TIM5", &known).map(|all| all.len()), Ok(2));
        assert!(check(&wakes("wake_with_panic"), "TIM5", &known).unwrap_err().contains("a panic"));
        assert!(check(&wakes("asleep"), "TIM5", &known).unwrap_err().contains("is not in the image"));
    }
}
