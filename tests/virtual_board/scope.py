"""Evaluates the recorded edges of the step outputs: pulses, steps, and the times that the data sheets of drivers
specify."""

from dataclasses import dataclass
from itertools import pairwise


@dataclass
class Step:
    """A step event: its edges may differ in time, because two ports are written one after the other."""

    at: int
    """Core cycle of the first rising edge."""
    axes: int
    """Bit 0 for X."""
    negative: int
    """Direction outputs of the stepped axes at the rising edge, bit 0 for X."""


class Scope:
    """Records the step and direction outputs of a board from its creation on."""

    TOGETHER_S = 0.5e-6
    """Rising edges closer than this are one step event."""

    def __init__(self, board, second=False):
        """With `second`, the second motor of an axis is recorded as a fourth axis."""
        self.board = board
        wiring = board.wiring
        steps, directions = wiring.step, wiring.direction
        if second:
            steps, directions = (*steps, wiring.second_step), (*directions, wiring.second_direction)
        self.motors = len(steps)
        self.step_pins = {(name[0], int(name[1:])): axis for axis, name in enumerate(steps)}
        self.direction_pins = {(name[0], int(name[1:])): axis for axis, name in enumerate(directions)}
        self.first = len(board.edges)
        self.levels = [board.shown(name) == 1 for name in directions]
        """Direction outputs at the beginning of the record."""

    def read(self):
        """Returns steps, pulse widths, direction set-up times and hold times since the scope was created; times in
        s."""
        board = self.board
        hz = board.clocks[-1][2]
        together = self.TOGETHER_S * hz
        negative = sum(1 << axis for axis, level in enumerate(self.levels) if level)
        steps, widths, setups, holds = [], [], [], []
        risen, changed, last_rise = {}, {}, {}
        for at, port, pin, level in board.edges[self.first :]:
            axis = self.step_pins.get((port, pin))
            if axis is not None:
                if level == 1:
                    risen[axis] = at
                    last_rise[axis] = at
                    if steps and at - steps[-1].at <= together and not steps[-1].axes >> axis & 1:
                        steps[-1].axes |= 1 << axis
                        steps[-1].negative |= negative & 1 << axis
                    else:
                        steps.append(Step(at, 1 << axis, negative & 1 << axis))
                    if axis in changed:
                        setups.append((at - changed.pop(axis)) / hz)
                elif level == 0 and axis in risen:
                    widths.append((at - risen.pop(axis)) / hz)
            axis = self.direction_pins.get((port, pin))
            if axis is not None and level in (0, 1):
                negative = negative & ~(1 << axis) | level << axis
                changed[axis] = at
                if axis in last_rise:
                    holds.append((at - last_rise[axis]) / hz)
        return steps, widths, setups, holds

    def steps(self):
        return self.read()[0]

    def counts(self):
        net = [0] * self.motors
        for step in self.steps():
            for axis in range(self.motors):
                if step.axes >> axis & 1:
                    net[axis] += -1 if step.negative >> axis & 1 else 1
        return net


def steady(steps, hz, period_s, ramp):
    """Compares steps, without `ramp` steps at each end, with a constant nominal period. Returns the maximum error of a
    single period, and the error of the last step's time, which shows accumulated errors; both in s. Returns None if
    there are too few steps."""
    times = [step.at / hz for step in steps[ramp : len(steps) - ramp]]
    periods = [b - a for a, b in pairwise(times)]
    if len(periods) < 20:
        return None
    return {
        "steps": len(times),
        "period_error": max(abs(p - period_s) for p in periods),
        "drift": abs(times[-1] - times[0] - len(periods) * period_s),
    }
