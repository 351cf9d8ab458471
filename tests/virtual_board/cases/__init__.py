"""Test cases on the virtual boards. Each case switches on a new board, yields its measurements as lines of text, and
raises `Failure` if the board does not behave as it should."""

from .beam import brown_out_of_a_beam, laser_start, raster
from .commands import flood, override_bursts
from .failures import (
    brown_out,
    deaf,
    failed_twice,
    faulted,
    hung,
    left_loader,
    lost_clock,
    low_at_power_up,
    overflowed,
    rebooted,
    recorded,
    unserved,
)
from .flash import power_cut, settings_write
from .inputs import emergency_stop, noise, probe, trips
from .jobs import boot, crystals, own_pins, streamed, tasks, waiting_line
from .outputs import fourth_axis, inverted_outputs, program_inputs, program_outputs, second_motor, spindle_pwm
from .stepping import (
    called_at_turns,
    disturbed,
    hard_start,
    late_segments,
    late_starts,
    masked_long,
    miscounts,
    pulses,
    safe_rate,
    tight,
    turns,
    turns_at_full_rate,
    zigzag,
)
from .stops import hold, lines_at_stops, ring_stops, stops, zigzag_stops
from .uart import baud_rates, disturbed_line, fast_flood, sampled, torn_line, uart_lines
from .usb import usb_answers, usb_flood, usb_lines, usb_port, usb_reset, usb_set_up_again, usb_stop, usb_unplugged, usb_unread

KNOWN = {
    ("nucleo_f446re", "turns at full rate"): "at 1 MHz a ring lasts 96 us: behind a turn 38 us are left, and 51 are wanted",
}
"""Known faults of the firmware, by board and case: they are shown, but do not count as failures."""


def all_cases(root):
    jobs = root / "tests" / "jobs"
    return [
        ("boot", boot),
        ("crystals", crystals),
        ("own pins", own_pins),
        ("tasks", tasks),
        ("waiting line", waiting_line),
        ("stream axes.nc", lambda bench: streamed(bench, jobs / "axes.nc")),
        ("stream lines.nc", lambda bench: streamed(bench, jobs / "lines.nc")),
        ("stream splines.nc", lambda bench: streamed(bench, jobs / "splines.nc")),
        ("pulses", pulses),
        ("safe rate", safe_rate),
        ("safe rate, disturbed", disturbed),
        ("safe rate, fast UART", fast_flood),
        ("tight pulses", tight),
        ("hard start", hard_start),
        ("laser start", laser_start),
        ("raster", raster),
        ("turns", turns),
        ("turns at full rate", turns_at_full_rate),
        ("zigzag", zigzag),
        ("called at turns", called_at_turns),
        ("hold", hold),
        ("stops", stops),
        ("stops on the ring", ring_stops),
        ("stops in a zigzag", zigzag_stops),
        ("masked for long", masked_long),
        ("late segments", late_segments),
        ("late starts", late_starts),
        ("miscounts", miscounts),
        ("trips", trips),
        ("emergency stop", emergency_stop),
        ("lines at stops", lines_at_stops),
        ("switch noise", noise),
        ("probe", probe),
        ("flood of realtime commands", flood),
        ("bursts of overrides", override_bursts),
        ("second motor", second_motor),
        ("fourth axis", fourth_axis),
        ("spindle PWM", spindle_pwm),
        ("outputs of programs", program_outputs),
        ("inputs of programs", program_inputs),
        ("baud rates", baud_rates),
        ("uart lines", uart_lines),
        ("uart flooded", sampled),
        ("torn line", torn_line),
        ("disturbed line", disturbed_line),
        ("settings write", settings_write),
        ("power cut", power_cut),
        ("fault", faulted),
        ("stack overflow", overflowed),
        ("failure in a failure", failed_twice),
        ("hung control task", hung),
        ("unserved tasks", unserved),
        ("recorded failure", recorded),
        ("masked for ever", deaf),
        ("lost clock", lost_clock),
        ("boot loader left", left_loader),
        ("restart on request", rebooted),
        ("brown-out", brown_out),
        ("brown-out of a beam", brown_out_of_a_beam),
        ("low supply at power-up", low_at_power_up),
        ("inverted outputs", inverted_outputs),
        ("usb", usb_port),
        ("usb flood", usb_flood),
        ("usb lines", usb_lines),
        ("usb answers", usb_answers),
        ("usb stop", usb_stop),
        ("usb unplugged", usb_unplugged),
        ("usb unread", usb_unread),
        ("usb reset", usb_reset),
        ("usb set up again", usb_set_up_again),
    ]
