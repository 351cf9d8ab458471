//! How much a call does: edges of the control-flow graph that it executes, which the compiler counts in a build with libFuzzer.
//! Without it nothing is counted, and no limit is reached.

#[cfg(feature = "libfuzzer")]
fn done() -> u64 {
    unsafe extern "C" {
        static mut oxmill_fuzz_work: u64;
    }
    // SAFETY: unsafe because another language defines and changes it; safe because it is a plain number, libFuzzer runs a target
    // in one thread, and a volatile read is made each time.
    unsafe { (&raw const oxmill_fuzz_work).read_volatile() }
}

#[cfg(not(feature = "libfuzzer"))]
fn done() -> u64 {
    0
}

/// Whether work is counted, once a target has run.
pub fn is_counted() -> bool {
    done() > 0
}

/// Makes a call that may do so much, and panics if it does more.
pub fn at_most<T>(most: u64, call: impl FnOnce() -> T) -> T {
    let before = done();
    let result = call();
    let work = done() - before;
    assert!(work <= most, "{work} edges in a call that may have {most}");
    result
}
