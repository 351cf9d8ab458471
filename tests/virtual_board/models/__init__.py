"""One model for each peripheral, written from the reference manuals RM0383 (STM32F411) and RM0390 (STM32F446) and from the
ARMv7-M architecture manual. Each says what it models and what it does not."""
