#!/usr/bin/env bash
# Runs an ELF file in QEMU, prints its defmt log, and ends with the program's own status:
# 0 passed, 101 failed, 124 hung, 134 locked up.
set -u
elf=$1
shift
timeout "${QEMU_TIMEOUT:-300}" qemu-system-arm -M mps2-an386 -display none -monitor none -serial null \
  -icount "${QEMU_ICOUNT:-shift=3,sleep=off}" -semihosting-config enable=on,target=native -kernel "$elf" "$@" </dev/null |
  defmt-print -e "$elf" --log-format '{s}'
exit "${PIPESTATUS[0]}"
