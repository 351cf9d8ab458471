"""Replaces code of the running image, so that a task hangs or fails."""

from ..board import Failure


def patch(bench, address, code):
    """Replaces instructions until `unpatch`."""
    bench.patched = (address, bench.board.read_memory(address, len(code)))
    put(bench, address, code)


def unpatch(bench):
    """Restores the image: the replaced code emulates a fault of the program, not of the flash."""
    put(bench, *bench.patched)


def put(bench, address, code):
    bench.board.write_memory(address, code)
    bench.board.core.forget_decoded()
    bench.board.core.uc.ctl_remove_cache(address, address + len(code))


def hang(bench):
    """Makes the control task's body an endless loop."""
    patch(bench, control_body(bench.image), b"\xfe\xe7")  # b .


def control_body(image):
    names = [name for _, _, name in image.functions if "control7Control" in name and ("4turn" in name or "4pass" in name)]
    if not names:
        raise Failure("the image has no function of the control task to hang")
    return next(start for start, _, name in image.functions if name == names[0])
