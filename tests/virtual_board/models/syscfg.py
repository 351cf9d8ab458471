"""System configuration controller (RM0390 chapter 8, RM0383 chapter 7), as far as it tells what is mapped at address 0.

Modelled: MEMRMP, which after a reset has what the boot pins choose. Not modelled: all else.
"""

from .peripheral import Peripheral

MEMRMP = 0x00
SYSTEM_MEMORY = 1
"""MEM_MODE of SYSCFG_MEMRMP."""


class Syscfg(Peripheral):
    REGISTERS = {MEMRMP: ("MEMRMP", 0, 0)}
    CLOCK = (0x44, 14)
