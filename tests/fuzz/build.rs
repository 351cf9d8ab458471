//! With libFuzzer, compiles the work counter separately in C: the counting code itself must not be counted.

fn main() {
    println!("cargo::rerun-if-changed=work.c");
    #[cfg(feature = "libfuzzer")]
    cc::Build::new().file("work.c").compile("work");
}
