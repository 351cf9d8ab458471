//! With libFuzzer, compiles the work counter, which is written in C, so that the counting code itself is not counted.

fn main() {
    println!("cargo::rerun-if-changed=work.c");
    #[cfg(feature = "libfuzzer")]
    cc::Build::new().file("work.c").compile("work");
}
