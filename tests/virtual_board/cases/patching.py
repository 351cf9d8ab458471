"""Code of the image that is replaced while it runs, so that a task hangs or fails."""

from ..board import Failure


def patch(bench, address, code):
    """Other instructions from now on, until `unpatch`."""
    bench.patched = (address, bench.board.read_memory(address, len(code)))
    put(bench, address, code)


def unpatch(bench):
    """The image as it was: what was put in stands for a fault of the program, not of the flash."""
    put(bench, *bench.patched)


def put(bench, address, code):
    bench.board.write_memory(address, code)
    bench.board.core.forget_decoded()
    bench.board.core.uc.ctl_remove_cache(address, address + len(code))


def hang(bench):
    """From now on the control task's body is an endless loop."""
    patch(bench, control_body(bench.image), b"\xfe\xe7")  # b .


def control_body(image):
    names = [name for _, _, name in image.functions if "control7Control" in name and ("4turn" in name or "4pass" in name)]
    if not names:
        raise Failure("the image has no function of the control task to hang")
    return next(start for start, _, name in image.functions if name == names[0])
