/* In place of what instrumented code calls at each edge of its graph (LLVM's SanitizerCoverage, `trace-pc`; libFuzzer has a
   function of that name, so the linker gives ours to those that call it: `--wrap`). */
#include <stdint.h>

uint64_t oxmill_fuzz_work;

void __wrap___sanitizer_cov_trace_pc(void)
{
    oxmill_fuzz_work++;
}
