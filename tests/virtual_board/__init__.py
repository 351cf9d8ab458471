"""The unmodified STM32 images on an emulated STM32F4. README.md has the manual."""
