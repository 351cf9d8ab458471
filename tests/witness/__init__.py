"""Runs the firmware on an independent emulator, labwired: its models confirm or refute the firmware's beliefs about the
hardware."""
