//! When the serial task is called for what can wait. Tasks of three priorities share its two variables: here each of them comes in
//! between any two accesses of one below it, in every way there is, from every state that comes about.

use oxmill_boards::calls::{Calls, REST, Word};
use std::cell::{Cell, RefCell};
use std::collections::BTreeSet;

/// Samples until a call at the latest, behind the one that a note may come too late for.
const LATEST: u8 = REST + 1;
/// Whole periods of sampling between two calls: the first may come within one, in front of its own count.
const LEAST: u8 = REST - 1;
/// Interrupts that come within one note of the task, or one sample.
const INTERRUPTS: u8 = 3;

/// All there is to know between two of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct State {
    rests: u8,
    is_due: u8,
    /// The serial task has been called, and has not begun.
    is_called: bool,
    /// It runs, and may have others come in between.
    runs: bool,
    /// Samples since the note began for which it was called, [`REST`] at most: others may come before the call.
    since: u8,
    /// Samples since the first note behind which it was not called.
    unheard: Option<u8>,
}

/// By priority.
#[derive(Clone, Copy, PartialEq)]
enum Who {
    /// The serial task itself: it has left something unread.
    Serial,
    Inputs,
    Uart,
}

/// Goes through all ways to choose, one after the other.
#[derive(Default)]
struct Choices {
    /// What was chosen, and of how many.
    made: Vec<(usize, usize)>,
    next: usize,
}

impl Choices {
    fn choose(&mut self, of: usize) -> usize {
        if self.next == self.made.len() {
            self.made.push((0, of));
        }
        self.next += 1;
        self.made[self.next - 1].0
    }

    /// On to the next way, if there is one.
    fn go_on(&mut self) -> bool {
        self.next = 0;
        while let Some((chosen, of)) = self.made.pop() {
            if chosen + 1 < of {
                self.made.push((chosen + 1, of));
                return true;
            }
        }
        false
    }
}

struct Machine {
    state: Cell<State>,
    who: Cell<Who>,
    interrupts: Cell<u8>,
    choices: RefCell<Choices>,
    samples: Cell<u8>,
    /// The latest call and the least time between two that there have been.
    latest: Cell<u8>,
    least: Cell<u8>,
}

/// One of the two variables.
struct Place<'a>(&'a Machine, fn(&mut State) -> &mut u8);

impl Word for Place<'_> {
    fn get(&self) -> u8 {
        self.0.come_in_between();
        *self.1(&mut self.0.state.get())
    }

    fn set(&self, value: u8) {
        self.0.come_in_between();
        self.0.change(|state| *self.1(state) = value);
    }
}

impl Machine {
    fn change(&self, how: impl FnOnce(&mut State)) {
        let mut state = self.state.get();
        how(&mut state);
        self.state.set(state);
    }

    fn calls(&self) -> Calls<Place<'_>> {
        Calls::new(Place(self, |state| &mut state.rests), Place(self, |state| &mut state.is_due))
    }

    /// Any number of those above, one behind the other.
    fn come_in_between(&self) {
        let above: &[fn(&Machine)] = match self.who.get() {
            Who::Serial => &[Machine::uart, Machine::sample],
            Who::Inputs => &[Machine::uart],
            Who::Uart => &[],
        };
        while !above.is_empty() && self.interrupts.get() > 0 {
            let chosen = self.choices.borrow_mut().choose(above.len() + 1);
            let Some(interrupt) = above.get(chosen) else { return };
            self.interrupts.set(self.interrupts.get() - 1);
            interrupt(self);
        }
    }

    fn as_one(&self, who: Who, does: impl FnOnce()) {
        let below = self.who.replace(who);
        does();
        self.who.set(below);
    }

    fn uart(&self) {
        self.as_one(Who::Uart, || self.note());
    }

    fn note(&self) {
        self.change(|state| _ = state.unheard.get_or_insert(0));
        self.call_soon();
    }

    fn call_soon(&self) {
        let began = self.samples.get();
        if self.calls().note() {
            self.come_in_between();
            let State { is_called, since, .. } = self.state.get();
            // One that has been called and has not begun hears all of it.
            if !is_called {
                assert!(since >= LEAST, "called {since} samples after the call before: {:?}", self.state.get());
                self.least.set(self.least.get().min(since));
                let since = self.samples.get().wrapping_sub(began);
                self.change(|state| (state.is_called, state.since) = (true, since));
            }
            self.change(|state| state.unheard = None);
        }
    }

    fn sample(&self) {
        self.as_one(Who::Inputs, || {
            self.samples.set(self.samples.get().wrapping_add(1));
            self.change(|state| state.since = REST.min(state.since + 1));
            if self.calls().sample() {
                self.call_soon();
            }
            self.change(|state| state.unheard = state.unheard.map(|samples| samples + 1));
            let unheard = self.state.get().unheard.unwrap_or(0);
            assert!(unheard < LATEST, "{unheard} samples without a call: {:?}", self.state.get());
            self.latest.set(self.latest.get().max(unheard + 1));
        });
    }

    fn begin_run(&self) {
        if self.state.get().is_called && !self.state.get().runs {
            self.change(|state| (state.is_called, state.runs, state.unheard) = (false, true, None));
        }
    }

    fn note_in_run(&self) {
        if self.state.get().runs {
            self.note();
        }
    }

    fn end_run(&self) {
        self.change(|state| state.runs = false);
    }
}

const AT_REST: State = State { rests: 0, is_due: 0, is_called: false, runs: false, since: REST, unheard: None };

#[test]
fn the_serial_task_is_called_in_time_and_not_too_often() {
    let machine = Machine {
        state: Cell::new(AT_REST),
        who: Cell::new(Who::Serial),
        interrupts: Cell::new(0),
        choices: RefCell::default(),
        samples: Cell::new(0),
        latest: Cell::new(0),
        least: Cell::new(REST),
    };
    let events: [fn(&Machine); 5] =
        [Machine::uart, Machine::sample, Machine::begin_run, Machine::note_in_run, Machine::end_run];
    let (mut known, mut new) = (BTreeSet::from([AT_REST]), vec![AT_REST]);
    while let Some(state) = new.pop() {
        for event in events {
            loop {
                machine.state.set(state);
                machine.interrupts.set(INTERRUPTS);
                event(&machine);
                if known.insert(machine.state.get()) {
                    new.push(machine.state.get());
                }
                if !machine.choices.borrow_mut().go_on() {
                    break;
                }
            }
        }
    }
    assert!(known.len() > 1000, "{} states", known.len());
    // Neither bound is wider than it has to be.
    assert_eq!((machine.latest.get(), machine.least.get()), (LATEST, LEAST));
    // And whatever has been, it comes to rest.
    for state in known {
        machine.state.set(state);
        for _ in 0..3 * REST {
            machine.interrupts.set(0);
            machine.sample();
            machine.begin_run();
            machine.end_run();
        }
        assert_eq!(machine.state.get(), AT_REST, "after {state:?}");
    }
}
