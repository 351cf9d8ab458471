"""One model for each peripheral, written from the reference manuals RM0383 (STM32F411) and RM0390 (STM32F446) and from the
ARMv7-M architecture manual. Each says what it models and what it does not.

No constant comes from the firmware: beside each is its source, a register or a titled section of these manuals, a data sheet or an application
note. Offsets and bits of registers are those of the register map at the end of the chapter that the model names. What the manuals leave open is in
`readings.py`."""
