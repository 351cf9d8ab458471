/* The part of the emulated processor that runs for every instruction: time, periods with masked interrupts, stacking.
 *
 * `core.now` is the time in core cycles at the present instruction (including its own cost when it accesses a
 * register). Emulation stops before the first instruction at or after `core.deadline`. board.py selects the exception
 * to take; the models implement the registers.
 *
 * Cost of an instruction: see core.py. Effects of the instruction before are added here: a taken branch refills the
 * pipeline (2 cycles), a load right after another load or store is pipelined with it. The sum is multiplied by
 * `core.margin`/256 for the flash's wait states.
 *
 * Not modelled: an instruction that is abandoned half-way (LDM, STM, divisions) for an interrupt; interrupts within an
 * IT block (they wait for its end, at most four instructions); lazy stacking of the FPU (its registers are stored at
 * entry, at no cost); clearing of the exclusive monitor at entry (a STREX still fails if the word has changed). */
#include <stdint.h>
#include <string.h>

enum { LOAD = 1, STORE = 2, SLEEP = 4, MASKS = 8, IN_IT = 16, FPU = 32 };
enum { DEADLINE = 1, ASLEEP, EXCEPTION_RETURN, FAULT };

typedef struct {
    uint8_t cost, flags, target, base; /* target, base: registers of a load, 255 for none */
} instruction;

typedef struct {
    uint64_t now, deadline;
    uint64_t instructions;
    uint64_t masked_since, masked_longest; /* PRIMASK, in cycles */
    uint64_t masked_longest_began;
    uint32_t margin, fraction;
    uint32_t at, next, after_memory, loaded; /* address of this instruction, of the next; last access, its register */
    uint32_t reason, fault;
    uint32_t primask, basepri, look_at_masks;
    uint32_t masked_from;
    uint32_t fpu_used;
    uint32_t pending; /* an exception waits until a mask is removed */
    uint32_t invalid, invalid_address;
    uint32_t slowest_from, slowest_to;
    uint32_t wait; /* cycles that a register access adds */
} state;

state core;
/* For a profile: cycles at each half-word of flash, and in each exception (0: in none), without entries and returns. */
uint32_t is_profiled;
uint64_t spent_at[1 << 18], spent_in[512];
static uint32_t exception;
instruction flash[1 << 18], ram[1 << 17], rom[1 << 9]; /* one for each half-word; rom: the start of system memory */
void (*decode)(uint32_t address, instruction *into);
int (*emu_stop)(void *);
int (*emu_start)(void *, uint64_t, uint64_t, uint64_t, uint64_t);
int (*reg_read)(void *, int, void *);
int (*reg_write)(void *, int, const void *);
int (*mem_read)(void *, uint64_t, void *, uint64_t);
int (*mem_write)(void *, uint64_t, const void *, uint64_t);
int register_ids[32]; /* r0 r1 r2 r3 r12 lr pc xpsr sp primask basepri fpscr ipsr d0..d7 */
enum { R0, R1, R2, R3, R12, LR, PC, XPSR, SP, PRIMASK, BASEPRI, FPSCR, IPSR, D0 };

static uint32_t get(void *uc, int which) {
    uint32_t value = 0;
    reg_read(uc, register_ids[which], &value);
    return value;
}
static void set(void *uc, int which, uint32_t value) { reg_write(uc, register_ids[which], &value); }

static void stop(void *uc, uint32_t reason) {
    core.reason = reason;
    emu_stop(uc);
}

static void note_masks(void *uc) {
    uint32_t primask = get(uc, PRIMASK) & 1;
    core.basepri = get(uc, BASEPRI) & 0xFF;
    if (primask && !core.primask) {
        core.masked_since = core.now;
        core.masked_from = core.at;
    }
    if (!primask && core.primask) {
        uint64_t masked = core.now - core.masked_since;
        if (masked > core.masked_longest) {
            core.masked_longest = masked;
            core.masked_longest_began = core.masked_since;
            core.slowest_from = core.masked_from;
            core.slowest_to = core.at;
        }
    }
    core.primask = primask;
    if (core.pending) core.deadline = 0;
}

void on_instruction(void *uc, uint64_t address, uint32_t size, void *data) {
    (void)data;
    uint32_t at = (uint32_t)address;
    if (at >= 0xFFFFFF00u) return;
    instruction *i;
    if (at - 0x08000000u < sizeof flash / sizeof *flash * 2) i = &flash[(at - 0x08000000u) >> 1];
    else if (at - 0x20000000u < sizeof ram / sizeof *ram * 2) i = &ram[(at - 0x20000000u) >> 1];
    else if (at - 0x1FFF0000u < sizeof rom / sizeof *rom * 2) i = &rom[(at - 0x1FFF0000u) >> 1];
    else { core.fault = 0; stop(uc, FAULT); return; }
    if (!i->cost) decode(at, i);
    uint64_t before = core.now;
    if (core.wait) {
        core.now += core.wait;
        core.wait = 0;
    }
    if (core.look_at_masks) {
        core.look_at_masks = 0;
        note_masks(uc);
    }
    if (core.now >= core.deadline && !(i->flags & IN_IT)) { stop(uc, DEADLINE); return; }
    core.at = at;
    if (i->flags & SLEEP) { stop(uc, ASLEEP); return; }
    uint32_t cost = i->cost;
    if (at != core.next) cost += 2;
    if (i->flags & LOAD && core.after_memory && i->base != core.loaded) cost -= 1;
    core.after_memory = i->flags & (LOAD | STORE);
    core.loaded = i->flags & LOAD ? i->target : 254;
    core.next = at + size;
    core.instructions++;
    if (i->flags & FPU) core.fpu_used = 1;
    if (i->flags & MASKS) core.look_at_masks = 1;
    core.fraction += cost * core.margin;
    core.now += core.fraction >> 8;
    core.fraction &= 255;
    if (is_profiled) {
        spent_in[exception] += core.now - before;
        if (at - 0x08000000u < sizeof flash / sizeof *flash * 2) spent_at[(at - 0x08000000u) >> 1] += core.now - before;
    }
}

void on_exception(void *uc, uint32_t number, void *data) {
    (void)data;
    core.fault = number;
    stop(uc, number == 8 ? EXCEPTION_RETURN : FAULT);
}

/* Returns false: unicorn ends the emulation with an error. */
int on_invalid(void *uc, int type, uint64_t address, int size, int64_t value, void *data) {
    (void)uc; (void)size; (void)value; (void)data;
    core.invalid = type;
    core.invalid_address = (uint32_t)address;
    return 0;
}

/* Continues the emulation. Returns unicorn's error. */
int run(void *uc) {
    core.reason = 0;
    return emu_start(uc, get(uc, PC) | 1, 0xFFFFFFFF, 0, 0);
}

/* Returns the program counter. */
uint32_t counter(void *uc) { return get(uc, PC); }

/* Exception entry (ARMv7-M, B1.5.6 to B1.5.8): frame of 8 words, or 26 with the FPU in use, on an 8-byte boundary. */
uint32_t enter(void *uc, uint32_t number, uint32_t vector, uint32_t thread) {
    uint32_t frame[26] = {0}, words = core.fpu_used ? 26 : 8, sp = get(uc, SP), psr = get(uc, XPSR);
    frame[0] = get(uc, R0); frame[1] = get(uc, R1); frame[2] = get(uc, R2); frame[3] = get(uc, R3);
    frame[4] = get(uc, R12); frame[5] = get(uc, LR); frame[6] = get(uc, PC) & ~1u;
    uint32_t padded = sp >> 2 & 1;
    frame[7] = (psr & ~(1u << 9)) | padded << 9 | 1u << 24;
    if (core.fpu_used) {
        for (int k = 0; k < 8; k++) reg_read(uc, register_ids[D0 + k], &frame[8 + 2 * k]);
        frame[24] = get(uc, FPSCR);
    }
    sp = (sp - 4 * words) & ~7u;
    int error = mem_write(uc, sp, frame, 4 * words);
    set(uc, SP, sp);
    set(uc, LR, 0xFFFFFFE0u | (core.fpu_used ? 0 : 0x10) | (thread ? 9 : 1));
    set(uc, XPSR, 1u << 24 | number);
    set(uc, PC, vector & ~1u);
    core.fpu_used = 0;
    core.next = 0;
    exception = number & 0x1FF;
    return error ? 0 : sp;
}

/* Exception return; `code` is the value that was branched to. Returns the number of the exception that continues, or
 * 0xFFFF on an error. */
uint32_t leave(void *uc, uint32_t code) {
    uint32_t frame[26], fpu = !(code & 0x10), words = fpu ? 26 : 8, sp = get(uc, SP);
    if (mem_read(uc, sp, frame, 4 * words)) return 0xFFFF;
    set(uc, R0, frame[0]); set(uc, R1, frame[1]); set(uc, R2, frame[2]); set(uc, R3, frame[3]);
    set(uc, R12, frame[4]); set(uc, LR, frame[5]);
    set(uc, XPSR, frame[7] & ~(1u << 9));
    set(uc, PC, frame[6]);
    set(uc, SP, sp + 4 * words + (frame[7] >> 9 & 1) * 4);
    if (fpu) {
        for (int k = 0; k < 8; k++) reg_write(uc, register_ids[D0 + k], &frame[8 + 2 * k]);
        set(uc, FPSCR, frame[24]);
    }
    core.fpu_used = fpu;
    core.next = 0;
    exception = frame[7] & 0x1FF;
    return exception;
}

/* Resets the state to that of a new processor; time continues. */
void reset(void) {
    uint64_t now = core.now;
    memset(&core, 0, sizeof core);
    core.now = now;
    core.deadline = now;
    core.margin = 256;
    exception = 0;
}
