/* Instrumented code calls `__sanitizer_cov_trace_pc` at each control-flow edge (LLVM's SanitizerCoverage, `trace-pc`).
   libFuzzer has a function of that name, so the linker option `--wrap` redirects the calls to the function here. */
#include <stdint.h>

uint64_t oxmill_fuzz_work;

void __wrap___sanitizer_cov_trace_pc(void)
{
    oxmill_fuzz_work++;
}
