//! Executes realtime commands (reset, stop, status, hold, start, jog cancel, overrides and toggles). They act
//! immediately, regardless of the line being executed. Also reacts to a host that has disconnected or has been silent
//! for too long (`$914`, `$922`, `$923`).

use crate::dispatch::Controller;
use crate::gcode::Dialect;
use crate::image::FULL_IMAGE;
use crate::machine::realtime_override::Overrides;
use crate::messages::{Coolant, Realtime};
use crate::protocol::reply_texts;
use crate::settings::Key;
use crate::states::State;
use crate::states::stops::orders::StopReason;
use crate::units::Duration;

impl<const N: usize> Controller<N> {
    pub(crate) fn realtime(&mut self, command: Realtime) {
        match command {
            Realtime::Reset => {
                self.m.lines.reset();
                self.abort_check();
                self.m.stops.begin(StopReason::Reset);
                self.finish_stop();
                self.release_held();
            }
            // Grbl ignores 0x19. But the serial task has counted a new epoch for the line bytes after it (see
            // `LineByte`), so the controller counts this epoch, too.
            Realtime::Stop if self.dialect() == Dialect::Grbl => {
                self.m.lines.advance_epoch();
                self.release_held();
            }
            Realtime::Stop => {
                self.m.lines.reset();
                self.abort_check();
                self.stop_softly(false);
                self.release_held();
            }
            Realtime::Status => self.m.replies.ask_status(),
            Realtime::CycleStart => self.cycle_start(),
            Realtime::FeedHold => self.feed_hold(),
            Realtime::SafetyDoor => self.open_door(),
            Realtime::JogCancel => {
                self.m.lines.cancel_jogs();
                if matches!(self.state, State::Jog { cancelling: false }) {
                    self.cancel_jog();
                }
                // A jog that has been read can still wait for room in the look-ahead. The state is not `State::Jog`
                // until the jog has been queued, so such a jog is dropped here.
                self.task.forget_jog();
                self.release_held();
            }
            Realtime::SpindleStop => {
                // A laser is off in a hold, and is switched on again only with motion.
                if matches!(self.state, State::Hold(_))
                    && self.m.accessories.is_on()
                    && !self.m.settings.is_on(Key::Laser)
                {
                    self.toggle_spindle();
                }
            }
            Realtime::FloodToggle => self.toggle_coolant(|c| c.flood = !c.flood),
            Realtime::MistToggle if self.dialect() != Dialect::Grbl => self.toggle_coolant(|c| c.mist = !c.mist),
            Realtime::SingleBlock if self.dialect() != Dialect::Grbl => {
                self.line.toggle_single_block();
                self.tell_single_block();
            }
            Realtime::FullStatus if FULL_IMAGE => self.m.replies.ask_full_status(),
            Realtime::ParserState if FULL_IMAGE => self.say_parser_state(),
            Realtime::OptionalStop if FULL_IMAGE => self.toggle_optional_stop(),
            Realtime::ToolReady if FULL_IMAGE => {
                if self.waits_for_tool() {
                    self.cycle_start();
                }
            }
            // Grbl drops these bytes.
            Realtime::MistToggle | Realtime::SingleBlock => {}
            _ => self.set_overrides(self.m.accessories.overrides().after(command)),
        }
    }

    fn toggle_coolant(&mut self, change: impl FnOnce(&mut Coolant)) {
        if matches!(self.state, State::Normal | State::Hold(_)) {
            let mut coolant = self.m.accessories.coolant();
            change(&mut coolant);
            self.m.accessories.set_coolant(coolant);
            self.m.interpreter.set_accessories(self.m.accessories.spindle(), coolant);
            self.m.replies.overrides_changed();
        }
    }

    fn set_overrides(&mut self, overrides: Overrides) {
        if self.m.accessories.set_overrides(overrides) {
            self.m.replies.overrides_changed();
        }
    }

    pub(crate) fn cycle_start(&mut self) {
        self.m.lines.heartbeat_mut().set_gone(false);
        match self.state {
            State::Normal => self.start_motion(),
            State::Hold(hold) if hold.ends_with_spindle().is_some() => {}
            State::Hold(_) if self.m.motion.is_at_rest() => self.end_hold(),
            State::Door(_) => self.close_door(),
            _ => {}
        }
    }

    /// Reacts to the disconnection of the host: no operator can stop or watch the motion any more. If `$914` is set, a
    /// job gets the reaction that `$928` selects. A jog always ends, because the key release that would end it can no
    /// longer arrive.
    pub(crate) fn host_left(&mut self) {
        // A jog that has been read but has not started must not start any more.
        self.task.forget_jog();
        match self.state {
            State::Jog { .. } => self.end_jog_of_no_host(self.m.settings.is_on(Key::HoldWithoutHost)),
            _ if !self.m.settings.is_on(Key::HoldWithoutHost) => {}
            State::Normal if self.is_at_work() => self.host_fault(),
            // The controller reacts to the loss of the host as soon as the job continues.
            State::Hold(hold) if hold.ends_with_spindle().is_some() => self.m.lines.heartbeat_mut().set_gone(true),
            _ if self.state.is_resuming() => {
                self.m.lines.heartbeat_mut().set_gone(true);
            }
            _ => {}
        }
    }

    /// Reacts to a host that has been silent for too long (`$922`, `$923`). The host can have disconnected without
    /// notice, because not every link reports a disconnection.
    pub(crate) fn look_for_host(&mut self) {
        if matches!(self.state, State::Normal) {
            let left_jog = self.m.lines.heartbeat_mut().take_left_jog();
            if self.m.lines.heartbeat_mut().take_gone() && self.is_at_work() || left_jog && self.burns() {
                self.host_fault();
            }
        }
        let longest = match self.state {
            State::Jog { cancelling: false } => Key::JogSilence,
            _ => Key::HostSilence,
        };
        if !self.m.settings.is_on(longest) {
            self.m.lines.heartbeat_mut().allow_silence();
        } else {
            self.look_for_silence(self.m.settings.seconds(longest));
        }
    }

    #[inline(never)]
    fn look_for_silence(&mut self, longest: Duration) {
        let is_at_work = match self.state {
            // A setting below one tick counts as 0: no limit.
            _ if longest == Duration::from_ticks(0) => false,
            State::Jog { cancelling } => !cancelling,
            State::Normal => self.is_at_work(),
            _ => false,
        };
        if !is_at_work {
            self.m.lines.heartbeat_mut().allow_silence();
        } else if self.m.lines.heartbeat_mut().is_silent(self.m.now, longest) {
            self.m.lines.heartbeat_mut().allow_silence();
            self.say(|out| reply_texts::message(out, "The host is silent"));
            match self.state {
                State::Jog { .. } => self.end_jog_of_no_host(true),
                _ => self.host_fault(),
            }
        }
    }

    /// Ends the jog of a host that has disconnected or is silent. `is_fault`: `true` if the loss of the host is a
    /// fault. In that case, if the laser is still on after the jog, the controller reacts as `$928` selects.
    fn end_jog_of_no_host(&mut self, is_fault: bool) {
        self.m.lines.heartbeat_mut().set_left_jog(is_fault);
        self.cancel_jog();
        self.forget_received_jogs();
    }
}
