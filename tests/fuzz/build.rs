//! Compiles the work counter (`work.c`) in a build with libFuzzer. The counter is in C, so that its own code is not
//! counted as work.

fn main() {
    println!("cargo::rerun-if-changed=work.c");
    #[cfg(feature = "libfuzzer")]
    cc::Build::new().file("work.c").compile("work");
}
