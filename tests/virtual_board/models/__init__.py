"""Models of the peripherals, one each, written from the reference manuals RM0383 (STM32F411) and RM0390 (STM32F446) and
from the ARMv7-M architecture manual. Each file head says what is modelled and what is not.

No constant is taken from the firmware. Each has its source beside it: a register or a titled section of these manuals,
a data sheet or an application note. Offsets and bits of registers are those of the register map at the end of the
chapter that the model names. Facts that the manuals leave open are in `readings.py`."""
