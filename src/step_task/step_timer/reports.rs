//! Reports of the step task to `control`, kept until they have been sent ([`Reports`]).

use crate::boards::AXES;
use crate::shared::Wake;
use oxmill_controller::messages::{EVENTS_DEPTH, StepEvent};
use rtic_sync::channel::Sender;

/// Reports that have not been sent yet. One slot for each kind is enough. The motion ends at an underrun, and brakes
/// after a probe's contact. The next motion begins only when `control` has answered the report. Of several stops, only
/// the newest must be reported.
pub struct Reports {
    /// The probe's contact was detected, but has not been reported yet.
    pub touched: bool,
    /// An underrun or a miscount that has not been reported yet.
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

    /// Sends the reports in the order in which their events happen, as far as the queue has room. `contact` returns the
    /// report of a contact of the probe.
    #[inline(never)]
    pub fn send_all(&mut self, contact: impl FnOnce() -> StepEvent<AXES>) {
        if self.touched {
            self.touched = !self.send(contact());
        }
        // A report must not overtake an earlier one that could not be sent.
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
