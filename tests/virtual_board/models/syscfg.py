"""System configuration controller (RM0390 chapter 8, RM0383 chapter 7), as far as it selects the memory at address 0.

Modelled: MEMRMP; after a reset it is 0 (flash), as the boot pins select. Not modelled: everything else.
"""

from .peripheral import Peripheral

MEMRMP = 0x00
SYSTEM_MEMORY = 1
"""Value of MEM_MODE in SYSCFG_MEMRMP."""


class Syscfg(Peripheral):
    REGISTERS = {MEMRMP: ("MEMRMP", 0, 3)}
    CLOCK = (0x44, 14)
