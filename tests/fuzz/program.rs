//! Runs the target that `OXMILL_FUZZ_TARGET` names: with libFuzzer on generated inputs, otherwise on the files given as
//! arguments.
#![cfg_attr(feature = "libfuzzer", no_main)]

fn chosen() -> fn(&[u8]) {
    let name = std::env::var("OXMILL_FUZZ_TARGET").unwrap_or_default();
    oxmill_fuzz::target(&name).unwrap_or_else(|| {
        let names: Vec<&str> = oxmill_fuzz::TARGETS.iter().map(|(name, _)| *name).collect();
        panic!("OXMILL_FUZZ_TARGET is one of {}", names.join(", "))
    })
}

#[cfg(feature = "libfuzzer")]
static CHOSEN: std::sync::LazyLock<fn(&[u8])> = std::sync::LazyLock::new(chosen);

#[cfg(feature = "libfuzzer")]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    CHOSEN(data);
    assert!(oxmill_fuzz::work::is_counted(), "the work of a call is not counted");
});

#[cfg(not(feature = "libfuzzer"))]
fn main() {
    let run = chosen();
    for path in std::env::args().skip(1) {
        let data = std::fs::read(&path).unwrap_or_else(|why| panic!("{path}: {why}"));
        println!("{path}: {} bytes", data.len());
        run(&data);
    }
}
