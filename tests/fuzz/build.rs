//! With libFuzzer, the counter of work is compiled: the compiler must not count the counting.

fn main() {
    println!("cargo::rerun-if-changed=work.c");
    #[cfg(feature = "libfuzzer")]
    cc::Build::new().file("work.c").compile("work");
}
