//! Homing: each cycle seeks its switches, pulls off, approaches them again slowly (locate) and pulls off.

use super::super::action::{Pin, TRAVEL};
use super::{Mode, Model, Span, Work};

// Rates of [`Setup::settings`]: seek (`$25`) and locate (`$24`) in mm/s, and debounce (`$26`) in s.
const SEEK: f64 = 2000.0 / 60.0;
const LOCATE: f64 = 10.0;
const DEBOUNCE: f64 = 0.05;
// Distances of a homing cycle, mm: the seek is 1.5 times the travel, the second approach 5 times the pull-off.
const PULL_OFF: f64 = 1.0;
const SEEK_DISTANCE: f64 = 1.5 * TRAVEL;
const LOCATE_DISTANCE: f64 = 5.0 * PULL_OFF;
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    Seek,
    PullOff,
    Locate,
    SecondPullOff,
}

impl Phase {
    /// Returns the duration of the phase's motion if no switch ends it.
    fn length(self) -> Span {
        match self {
            Phase::Seek => Span::length(SEEK_DISTANCE / SEEK, 0.2),
            Phase::Locate => Span::length(LOCATE_DISTANCE / LOCATE, 0.1),
            Phase::PullOff | Phase::SecondPullOff => Span::length(PULL_OFF / SEEK, 0.2),
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Homing {
    /// 0: Z; 1: X and Y.
    cycle: usize,
    phase: Phase,
    /// `true` after the motion of the phase has ended. Then the controller waits for [`DEBOUNCE`], because switches
    /// bounce.
    settles: bool,
    touched: [bool; 3],
    /// Time at which the phase's motion ends if no switch ends it. If `settles` is `true`: the time at which the wait
    /// for the switches ends.
    pub(super) time: Span,
}

const CYCLES: [&[usize]; 2] = [&[2], &[0, 1]];

impl Model {
    pub(super) fn begin_homing(&mut self) {
        self.trusted = false;
        self.place = [None; 3];
        self.work = Some(Work::Homing);
        self.begin_phase(0, Phase::Seek);
    }

    pub(super) fn begin_phase(&mut self, cycle: usize, phase: Phase) {
        self.mode = Mode::Home(Homing {
            cycle,
            phase,
            settles: false,
            touched: [false; 3],
            time: self.now.plus(phase.length()),
        });
        for axis in 0..3 {
            if self.on(Pin::Limit(axis)) {
                self.switch_touched(axis);
            }
        }
    }

    pub(super) fn switch_touched(&mut self, axis: usize) {
        let now = self.now;
        let Mode::Home(homing) = &mut self.mode else { return };
        if homing.settles || matches!(homing.phase, Phase::PullOff | Phase::SecondPullOff) {
            return;
        }
        let cycle = CYCLES[homing.cycle];
        let is_new = cycle.contains(&axis) && !homing.touched[axis];
        homing.touched[axis] = true;
        if cycle.iter().all(|axis| homing.touched[*axis]) {
            homing.settles = true;
            homing.time = now.plus(Span::length(DEBOUNCE, 0.0));
        } else if is_new {
            // Oxmill: one axis of the cycle has found its switch. From where the other axis is now, it may still move
            // the whole distance of the phase.
            homing.time = now.plus(homing.phase.length());
        }
    }

    pub(super) fn homing_phase_ends(&mut self, also: &mut Vec<Model>) {
        let now = self.now;
        let limits: Vec<bool> = self.pins[..3].to_vec();
        let Mode::Home(homing) = &mut self.mode else { return };
        let (cycle, phase) = (homing.cycle, homing.phase);
        let is_pull_off = matches!(phase, Phase::PullOff | Phase::SecondPullOff);
        if !homing.settles && is_pull_off {
            homing.settles = true;
            homing.time = now.plus(Span::length(DEBOUNCE, 0.0));
            return;
        }
        if !homing.settles {
            return self.fail_homing(9, also);
        }
        if is_pull_off && CYCLES[cycle].iter().any(|axis| limits[*axis]) {
            return self.fail_homing(8, also);
        }
        match phase {
            Phase::Seek => self.begin_phase(cycle, Phase::PullOff),
            Phase::PullOff => self.begin_phase(cycle, Phase::Locate),
            Phase::Locate => self.begin_phase(cycle, Phase::SecondPullOff),
            Phase::SecondPullOff if cycle + 1 < CYCLES.len() => self.begin_phase(cycle + 1, Phase::Seek),
            Phase::SecondPullOff => {
                self.mode = Mode::Free;
                self.work = None;
                self.trusted = true;
                self.place = [Some(-PULL_OFF); 3];
                self.say("ok");
                self.read(also);
            }
        }
    }
}
