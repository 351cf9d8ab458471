//! Measures the work of a call as the number of control-flow edges executed, which the compiler counts in a build with
//! libFuzzer. Without libFuzzer nothing is counted, and no limit applies.

#[cfg(feature = "libfuzzer")]
fn done() -> u64 {
    unsafe extern "C" {
        static mut oxmill_fuzz_work: u64;
    }
    // SAFETY: unsafe because the variable is defined and changed in another language. Sound because it is a plain
    // number, libFuzzer runs a target in one thread, and each read is volatile.
    unsafe { (&raw const oxmill_fuzz_work).read_volatile() }
}

#[cfg(not(feature = "libfuzzer"))]
fn done() -> u64 {
    0
}

/// Returns whether work is counted; valid after a target has run.
pub fn is_counted() -> bool {
    done() > 0
}

/// Makes a call and panics if it executes more than `most` edges.
pub fn at_most<T>(most: u64, call: impl FnOnce() -> T) -> T {
    let before = done();
    let result = call();
    let work = done() - before;
    assert!(work <= most, "{work} edges in a call that may have {most}");
    result
}
