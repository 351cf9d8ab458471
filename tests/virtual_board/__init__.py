"""Runs the unmodified STM32 images on an emulated STM32F4; for use, see README.md."""
