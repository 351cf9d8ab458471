"""The processor: unicorn's Cortex-M4F, with time and exceptions added.

Computes the cost of each instruction (below) and gives access to the state in core.c. core.c does the work that is
needed for every executed instruction; board.py decides when to stop the emulation and what to do then.

Cost in core cycles at zero wait states, an estimate after ARM DDI 0439 (Cortex-M4 TRM), table 3-1: 1 for most; load 2;
store 1, with a register offset 2; load or store of n registers 1+n; division 7 (really 2 to 12, depending on its
operands); VDIV, VSQRT 14; multiply-accumulate of floats 3; barriers 3; TBB, TBH 2. core.c adds 2 for a taken branch
(really 1 to 3).
"""

import ctypes
import functools
import re
import subprocess
import tempfile
from pathlib import Path

from capstone import CS_ARCH_ARM, CS_MODE_MCLASS, CS_MODE_THUMB, Cs
from capstone.arm import ARM_OP_MEM, ARM_OP_REG
from unicorn import UC_ARCH_ARM, UC_HOOK_CODE, UC_HOOK_INTR, UC_MODE_MCLASS, UC_MODE_THUMB, Uc
from unicorn import UC_HOOK_MEM_INVALID
from unicorn import arm_const
from unicorn.unicorn_py3 import unicorn as unicorn_library

LOAD, STORE, SLEEP, MASKS, IN_IT, FPU = 1, 2, 4, 8, 16, 32
DEADLINE, ASLEEP, EXCEPTION_RETURN, FAULT = 1, 2, 3, 4

NEVER = 1 << 62
"""A deadline that is never reached."""


class Instruction(ctypes.Structure):
    _fields_ = [(name, ctypes.c_uint8) for name in ("cost", "flags", "target", "base")]


class State(ctypes.Structure):
    """The same layout as `state` in core.c."""

    _fields_ = [
        (name, ctypes.c_uint64)
        for name in ("now", "deadline", "instructions", "masked_since", "masked_longest", "masked_longest_began")
    ] + [
        (name, ctypes.c_uint32)
        for name in (
            "margin", "fraction", "at", "next", "after_memory", "loaded", "reason", "fault", "primask", "basepri",
            "look_at_masks", "masked_from", "fpu_used", "pending", "invalid", "invalid_address",
            "slowest_from", "slowest_to", "wait",
        )
    ]  # fmt: skip


MULTIPLE = re.compile(r"^(v?ldm|v?stm|push|pop|vpush|vpop)")
CONDITION = re.compile(r"(eq|ne|cs|hs|cc|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)$")
REGISTERS = {f"r{n}": n for n in range(16)} | {"sb": 9, "sl": 10, "fp": 11, "ip": 12, "sp": 13, "lr": 14, "pc": 15}


def registers_of(instruction):
    """Returns the number of words that a load or store of several registers moves."""
    count = 0
    for place, operand in enumerate(instruction.operands):
        if operand.type == ARM_OP_REG and not (place == 0 and "push" not in instruction.mnemonic and "pop" not in instruction.mnemonic):
            count += 2 if instruction.reg_name(operand.reg).startswith("d") else 1
    return count


def cost_of(instruction):
    """Returns cycles, flags, loaded register and base register of an instruction; 255 for no register."""
    name = instruction.mnemonic.split(".")[0]
    operands = instruction.operands
    if MULTIPLE.match(name):
        flags = LOAD | STORE if name.startswith("v") else STORE
        return 1 + registers_of(instruction), flags | (FPU if name.startswith("v") else 0), 255, 255
    memory = next((o.mem for o in operands if o.type == ARM_OP_MEM), None)

    def register(number):
        return REGISTERS.get(instruction.reg_name(number) or "", 255)

    fpu = FPU if name.startswith("v") else 0
    wide = bool(fpu and operands and operands[0].type == ARM_OP_REG and instruction.reg_name(operands[0].reg).startswith("d"))
    if name.startswith(("tbb", "tbh")):
        return 2, LOAD, 255, 255
    if name.startswith(("ldrd", "strd")):
        return 3, STORE, 255, 255
    if memory and name.startswith(("ldr", "vldr")):
        return (3 if wide else 2), LOAD | fpu, register(operands[0].reg), register(memory.base)
    if memory and name.startswith(("str", "vstr")):
        return (2 if wide else 1) + (1 if memory.index else 0), STORE | fpu, 255, 255
    if name.startswith(("udiv", "sdiv")):
        return 7, 0, 255, 255
    if name.startswith(("vdiv", "vsqrt")):
        return 14, fpu, 255, 255
    if name.startswith(("vmla", "vmls", "vnmla", "vnmls", "vfma", "vfms", "vfnma", "vfnms")):
        return 3, fpu, 255, 255
    if name.startswith(("dsb", "isb", "dmb")):
        return 3, 0, 255, 255
    if name.startswith(("wfi", "wfe")):
        return 1, SLEEP, 255, 255
    if name.startswith(("cps", "msr")):
        return 1 if name.startswith("cps") else 2, MASKS, 255, 255
    return 1, fpu, 255, 255


@functools.cache
def compiled():
    """Compiles and loads core.c, once per process. The library keeps its decoded instructions when a `Core` is replaced
    by a new one."""
    source = Path(__file__).with_name("core.c")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "core.so"
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
        return ctypes.CDLL(str(library))


class Core:
    """One processor. core.c has a single state, so only the newest Core in a process works."""

    image = None
    """The image whose decoded instructions core.c holds."""

    def __init__(self, image):
        self.library = compiled()
        if Core.image is not image:
            self.forget_decoded()
            Core.image = image
        self.state = State.in_dll(self.library, "core")
        self.uc = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        self.uc.ctl_set_cpu_model(arm_const.UC_CPU_ARM_CORTEX_M4)
        self.handle = self.uc._uch
        self.callbacks = []
        self.disassembler = Cs(CS_ARCH_ARM, CS_MODE_THUMB | CS_MODE_MCLASS)
        self.disassembler.detail = True
        self._connect()
        self.library.reset()

    def _connect(self):
        library, uclib = self.library, unicorn_library.uclib
        for ours, theirs in {
            "emu_stop": "uc_emu_stop", "emu_start": "uc_emu_start", "reg_read": "uc_reg_read", "reg_write": "uc_reg_write",
            "mem_read": "uc_mem_read", "mem_write": "uc_mem_write",
        }.items():  # fmt: skip
            ctypes.c_void_p.in_dll(library, ours).value = ctypes.cast(getattr(uclib, theirs), ctypes.c_void_p).value
        names = "R0 R1 R2 R3 R12 LR PC XPSR SP PRIMASK BASEPRI FPSCR IPSR D0 D1 D2 D3 D4 D5 D6 D7".split()
        identifiers = (ctypes.c_int * 32).in_dll(library, "register_ids")
        for place, name in enumerate(names):
            identifiers[place] = getattr(arm_const, "UC_ARM_REG_" + name)
        self._decode = ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.POINTER(Instruction))(self._decode_into)
        ctypes.c_void_p.in_dll(library, "decode").value = ctypes.cast(self._decode, ctypes.c_void_p).value
        for kind, name in ((UC_HOOK_CODE, "on_instruction"), (UC_HOOK_INTR, "on_exception"), (UC_HOOK_MEM_INVALID, "on_invalid")):
            hook = ctypes.c_size_t()
            error = uclib.uc_hook_add(
                self.handle, ctypes.byref(hook), ctypes.c_int(kind), ctypes.cast(getattr(library, name), ctypes.c_void_p),
                None, ctypes.c_uint64(1), ctypes.c_uint64(0),
            )  # fmt: skip
            assert error == 0, error
        for name in ("enter", "leave", "counter"):
            getattr(library, name).restype = ctypes.c_uint32
        library.counter.argtypes = [ctypes.c_void_p]
        library.run.argtypes = [ctypes.c_void_p]
        library.enter.argtypes = [ctypes.c_void_p] + [ctypes.c_uint32] * 3
        library.leave.argtypes = [ctypes.c_void_p, ctypes.c_uint32]

    def _decode_into(self, address, into):
        entry = into.contents
        code = bytes(self.uc.mem_read(address, 4))
        instruction = next(self.disassembler.disasm(code, address, 1), None)
        if instruction is None:
            # Unknown to the disassembler: unicorn decides what to do.
            entry.cost, entry.flags, entry.target, entry.base = 1, 0, 255, 255
            return
        cost, flags, target, base = cost_of(instruction)
        entry.cost, entry.target, entry.base = cost, target, base
        entry.flags = flags | (IN_IT if self._is_in_it(address) else 0)

    def _is_in_it(self, address):
        # IT is 0xBFxy with y not 0; the lowest set bit of y encodes the length of its block, 1 to 4 instructions.
        for back in range(1, 9):
            word = int.from_bytes(self.uc.mem_read(address - 2 * back, 2), "little")
            if word >> 8 == 0xBF and word & 15:
                length = 4 - ((word & 15) & -(word & 15)).bit_length() + 1
                at, seen = address - 2 * back + 2, 0
                while at < address and seen < length:
                    half = int.from_bytes(self.uc.mem_read(at, 2), "little")
                    at += 4 if half >> 11 in (0x1D, 0x1E, 0x1F) else 2
                    seen += 1
                # The second half of a wide instruction can look like an IT. If it is mistaken for one, an interrupt is
                # only delayed.
                if at == address and seen < length:
                    return True
        return False

    @staticmethod
    def forget_decoded():
        """Discards the decoded instructions. Call after the contents of flash have changed."""
        for name, words in (("flash", 1 << 18), ("ram", 1 << 17), ("rom", 1 << 9)):
            ctypes.memset((Instruction * words).in_dll(compiled(), name), 0, words * 4)

    READ = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint, ctypes.c_void_p)
    WRITE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint, ctypes.c_uint64, ctypes.c_void_p)

    def map_registers(self, address, size, read, write):
        """Calls `read(_, offset, size, _)` and `write(_, offset, size, value, _)` for accesses to a range."""
        # Calls unicorn's library directly, because unicorn's Python wrapper takes twice as long. `callbacks` keeps the
        # callbacks alive.
        calls = self.READ(read), self.WRITE(write)
        self.callbacks.append(calls)
        error = unicorn_library.uclib.uc_mmio_map(
            self.handle, ctypes.c_uint64(address), ctypes.c_size_t(size), calls[0], None, calls[1], None
        )
        assert error == 0, error

    def run(self):
        return self.library.run(self.handle)

    def enter(self, number, vector, thread):
        return self.library.enter(self.handle, number, vector, thread)

    def leave(self, code):
        return self.library.leave(self.handle, code)

    def read(self, name):
        return self.uc.reg_read(getattr(arm_const, "UC_ARM_REG_" + name.upper()))

    def write(self, name, value):
        self.uc.reg_write(getattr(arm_const, "UC_ARM_REG_" + name.upper()), value)
