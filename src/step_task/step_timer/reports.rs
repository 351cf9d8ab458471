//! `Reports`: what the step task tells `control`, kept until it has been sent. `touched` (the probe), `underrun` (or a
//! miscount) and `stopped` each have a place of their own; `send_all` sends them in the order in which they happen, as
//! far as the queue of `StepEvent` has room (`try_send`), `any` says that something is left, and `wake` runs the
//! control task.

use crate::boards::AXES;
use crate::shared::Wake;
use oxmill_controller::messages::{EVENTS_DEPTH, StepEvent};
use rtic_sync::channel::Sender;

/// Events that have not been sent yet, in the order in which they happen. Each kind has a place of its own and cannot
/// happen twice before it has been sent: after a contact or an underrun nothing moves until `control` has answered, and
/// it answers what it has received; of several stops the newest count is what it has to answer.
pub struct Reports {
    /// The probe has been seen.
    pub touched: bool,
    pub underrun: Option<StepEvent<AXES>>,
    pub stopped: Option<StepEvent<AXES>>,
    events: Sender<'static, StepEvent<AXES>, EVENTS_DEPTH>,
    wake: Wake,
}

impl Reports {
    pub fn new(events: Sender<'static, StepEvent<AXES>, EVENTS_DEPTH>, wake: Wake) -> Reports {
        Reports { touched: false, underrun: None, stopped: None, events, wake }
    }

    pub fn any(&self) -> bool {
        self.touched || self.underrun.is_some() || self.stopped.is_some()
    }

    pub fn wake(&mut self) {
        self.wake.write(());
    }

    /// Sends what there is to report, as far as there is room; of a contact, this.
    #[inline(never)]
    pub fn send_all(&mut self, contact: impl FnOnce() -> StepEvent<AXES>) {
        if self.touched {
            self.touched = !self.send(contact());
        }
        // No event overtakes another.
        if !self.touched
            && let Some(event) = self.underrun
            && self.send(event)
        {
            self.underrun = None;
        }
        if !self.touched
            && self.underrun.is_none()
            && let Some(event) = self.stopped
            && self.send(event)
        {
            self.stopped = None;
        }
    }

    #[inline(never)]
    fn send(&mut self, event: StepEvent<AXES>) -> bool {
        let sent = self.events.try_send(event).is_ok();
        if sent {
            self.wake.write(());
        }
        sent
    }
}
