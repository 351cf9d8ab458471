"""Settings written to flash, also with a power cut during the write."""

from ..board import Failure
from .bench import us


def settings_write(bench):
    """Writes settings and erases sectors while lines keep arriving: each line must be answered, and all settings must
    survive a reset."""
    bench.boot()
    board, host = bench.board, bench.host
    before, operations, erases = len(host.answers), board.flash.operations, board.flash.erases
    # There are enough lines to fill a sector, so that a sector has to be erased.
    lines = [f"${130 + k % 3}={200 + k}.5" if k % 8 else "G4P0" for k in range(1600)]
    bench.forget_masks()
    host.stream("\n".join(lines))
    bench.wait(lambda: host.all_answered, 20, "the last answer")
    board.run(seconds=0.5)
    answers = host.answers[before:]
    if answers != ["ok"] * len(lines) or board.usart.overruns or host.has_said("lost"):
        raise Failure(f"{answers.count('ok')} of {len(lines)} answered ok, {board.usart.overruns} overruns: {answers[-3:]}")
    if board.flash.erases == erases:
        raise Failure("no sector was erased: this proves nothing")
    mask, where = bench.longest_mask()
    yield f"{len(lines)} lines, {board.flash.operations - operations} flash operations, {board.flash.erases - erases} of them erases, no byte lost; longest time masked {us(mask)} ({where})"
    shown = bench.ask("$$")
    board.request_reset(None, "power")
    host.text.clear()
    bench.wait_text("Grbl 1.1h", 1)
    again = bench.ask("$$")
    shown, again = ([line for line in text if line.startswith("$")] for text in (shown, again))
    if shown != again:
        raise Failure("settings changed over a reset")
    yield f"{len(again)} settings unchanged after a reset"


def power_cut(bench):
    """Cuts the power at each flash operation of a settings write: the value must be the old or the new one."""
    bench.boot()
    board = bench.board
    bench.ask("$130=321.5")
    start = board.flash.operations
    bench.ask("$130=654.25")
    needed = board.flash.operations - start
    if needed == 0:
        raise Failure("nothing was written")
    seen = []
    for cut in range(needed + 1):
        bench.boot()
        bench.ask("$130=321.5")
        board = bench.board
        board.operations_left = cut
        bench.host.send("$130=654.25\n")
        board.run(seconds=0.1)
        flash = board.read_memory(board.part.flash_start, board.part.flash_kib * 1024)
        board = bench.fresh()
        board.write_memory(board.part.flash_start, flash)
        bench.wait_text("Grbl 1.1h", 2)
        value = next(line for line in bench.ask("$$") if line.startswith("$130=")).split("=")[1]
        if float(value) not in (321.5, 654.25):
            raise Failure(f"power cut before operation {cut} of {needed}: $130={value}")
        seen.append(float(value))
    if sorted(seen) != seen or seen[0] != 321.5 or seen[-1] != 654.25:
        raise Failure(f"values over the cuts: {seen}")
    yield f"{needed} operations in a write: cut after 0 to {needed} of them, {seen.count(321.5)} times the old value, then the new"
