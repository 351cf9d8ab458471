"""The firmware on an emulator whose authors have never seen it: what it believes of the hardware is confirmed, or not, by others."""
