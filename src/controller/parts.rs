//! [`Machine`]: the parts of the machine that all states and lines work on. It contains neither the current state nor
//! the line being executed.

use crate::axes::AxisMask;
use crate::dispatch::Profile;
use crate::gcode::Interpreter;
use crate::host::settings_lock::SettingsLock;
use crate::host::stored::Records;
use crate::inputs::levels::InputLevels;
use crate::lent::Lent;
use crate::machine::accessories::Accessories;
use crate::machine::drivers::Drivers;
use crate::machine::reference::Reference;
use crate::machine::step_supply::StepSupply;
use crate::memory::Memory;
use crate::messages::SpindleDirection;
use crate::motion::Motion;
use crate::outputs::given::Pins;
use crate::protocol::intake::LineIntake;
use crate::protocol::reply_queue::Replies;
use crate::settings::{Key, Settings};
use crate::states::door::parking::Parking;
use crate::states::stops::orders::Stops;
use crate::units::{Duration, Instant};
use crate::work::probe::phases::Probe;

/// If the host sends nothing for this time (5 s) after the answer to its last line, its next line may belong to
/// another program. An O number in such a line begins the next program, and a program that waits for one of its
/// subprograms is dropped. A sender that continues its file sends its next line sooner.
const REST: Duration = Duration::from_ticks(5_000_000);

// Small fields come first, because one load or store instruction reaches only 4 KiB from the base.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[repr(C)]
pub(crate) struct Machine<const N: usize> {
    pub settings: Settings<N>,
    pub reference: Reference,
    pub step_supply: StepSupply,
    pub accessories: Accessories,
    pub probe: Probe<N>,
    pub inputs: InputLevels,
    pub drivers: Drivers,
    pub stops: Stops,
    pub pins: Pins,
    pub settings_lock: SettingsLock,
    pub now: Instant,
    /// Time at which the host's last line was answered. If a hold, an open door or another suspended state ended later,
    /// it is the time of that end. Most `$` lines do not count. The exceptions end in `Controller::finish` with
    /// `Answer::Host`: jogs, `$H` and `$I=`, for example.
    pub last_line_at: Instant,
    pub lines: LineIntake,
    pub interpreter: Lent<Interpreter<N>>,
    pub replies: Lent<Replies>,
    pub records: Lent<Records>,
    pub parking: Parking<N>,
    pub motion: Lent<Motion<N>>,
}

impl<const N: usize> Machine<N> {
    pub(crate) fn new(profile: Profile, memory: Memory<N>) -> Self {
        Self {
            settings: Settings::of_board(profile.axes),
            interpreter: memory.interpreter,
            motion: memory.motion,
            parking: Parking::new(memory.parking),
            lines: LineIntake::new(),
            reference: Reference::ASSUMED,
            step_supply: StepSupply::AT_REST,
            accessories: Accessories::OFF,
            probe: Probe::NONE,
            inputs: InputLevels::UNKNOWN,
            drivers: Drivers::OFF,
            stops: Stops::NONE,
            replies: memory.replies,
            pins: Pins::UNKNOWN,
            settings_lock: SettingsLock::new(&profile),
            records: memory.records,
            now: Instant::from_ticks(0),
            last_line_at: Instant::from_ticks(0),
        }
    }

    pub(crate) fn start_motion(&mut self) {
        self.step_supply.start();
        self.motion.start();
    }

    #[inline(never)]
    pub(crate) fn start_idle_delay(&mut self) {
        self.drivers.motion_ended(self.now, self.settings.whole(Key::IdleDelay));
    }

    /// Switches the spindle off if it is on, as M5 would. Also updates the interpreter's modal state, so the next line
    /// starts with the spindle off.
    pub(crate) fn stop_spindle(&mut self) {
        if self.accessories.is_on() {
            self.accessories.stop_spindle();
            self.interpreter.set_accessories(SpindleDirection::Off, self.accessories.coolant());
            self.replies.overrides_changed();
        }
    }

    /// Returns whether M6 pauses for a tool change (`$918`).
    pub(crate) fn prompts_for_tools(&self) -> bool {
        self.settings.is_on(Key::ToolChange)
    }

    /// Returns whether the machine is at rest, and the host has sent no line for at least 5 s ([`REST`]), so that the
    /// next line may belong to another program.
    #[inline(never)]
    pub(crate) fn has_rested(&self) -> bool {
        self.motion.is_idle() && self.now.checked_duration_since(self.last_line_at).is_some_and(|rest| rest >= REST)
    }

    pub(crate) fn switches(&self) -> AxisMask {
        AxisMask(self.inputs.signals().limits)
    }
}
