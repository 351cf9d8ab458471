//! State that survives a power cycle: settings, offsets, tools, startup lines, macros and the build info text. Restores
//! records at power-up, turns changes into records for the store, and counts the changes that have not been stored yet.
//! If records were damaged, the machine stays locked until the operator confirms the settings with `$X`.

use crate::axes::{Axis, LINEAR, PerAxis};
use crate::gcode::{Angle, Interpreter, StoredOffset, Tool};
use crate::messages::{Record, STORE_DAMAGED, Store};
use crate::protocol::system::Restore;
use crate::settings::{Key, Settings};
use crate::units::{Coordinate, Duration, Instant};

/// Maximum length of a stored startup line, macro line or build info, in bytes.
pub(crate) const STORED_TEXT: usize = 80;
/// The text of a startup line, a macro line or the build info.
pub(crate) type StoredText = heapless::Vec<u8, STORED_TEXT>;

// Keys of stored records. The key of a setting is its number (0 to 999). All keys that one `$RST` forgets form one
// range, which is removed as a whole, so a power cut cannot leave a part of it.
const KEY_OFFSETS: u16 = 1000;
/// Key of the first entry of the tool table.
const KEY_TOOLS: u16 = 1040;
const KEY_STARTUP: u16 = 1100;
const KEY_BUILD_INFO: u16 = 1200;
/// Key of the first macro line.
const KEY_MACROS: u16 = 1300;
/// Key of the dialect. It is outside the ranges that `$RST` forgets, because the connected host relies on the dialect.
const KEY_DIALECT: u16 = 2000;
const DIALECT: u16 = Key::Dialect.number();
const SOFT_LIMITS: u16 = Key::SoftLimits.number();

/// Minimum time between listing the settings and confirming them. A person needs at least this long to read them. A
/// program that lists the settings and unlocks at once has not checked them.
const LOOKING: Duration = Duration::secs(2);

/// State of damaged records: the store has reported damage ([`STORE_DAMAGED`]), or a stored value is not valid for its
/// setting. Settings that protect the machine can be lost, so the machine is locked until somebody has read and
/// confirmed the settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Damage {
    /// No damage.
    None,
    /// The settings have not been listed since the last welcome line.
    Untold,
    /// `$$` was answered at this time.
    Listed(Instant),
}

/// Stored texts, and changes on their way to the store. Other modules own the settings and offsets.
// Small fields first: see `Controller`.
#[derive(Clone, Debug)]
#[repr(C)]
pub(crate) struct Records {
    /// Whether the board has a settings flash; without it, no records go to the store.
    has_store: bool,
    /// Number of changes that the store has not answered yet.
    unstored: u8,
    /// At least one change could not be stored since `unstored` was last 0.
    failed: bool,
    damage: Damage,
    /// Keys of settings whose stored value is invalid. The capacity is 3, so that three corrections and the removal of
    /// the damage mark just fit into `stores`.
    refused: heapless::Vec<u16, 3>,
    stores: heapless::Deque<Store, 4>,
    startup_lines: [StoredText; 2],
    /// A startup line that is executed before it is stored.
    validated: StoredText,
    build_info: StoredText,
}

impl Records {
    /// Creates the records at power-up, without texts and changes. `has_store`: the board has a settings flash.
    pub(crate) const fn new(has_store: bool) -> Self {
        Self {
            has_store,
            unstored: 0,
            failed: false,
            damage: Damage::None,
            refused: heapless::Vec::new(),
            stores: heapless::Deque::new(),
            startup_lines: [heapless::Vec::new(), heapless::Vec::new()],
            validated: heapless::Vec::new(),
            build_info: heapless::Vec::new(),
        }
    }

    /// Restores a record at power-up. An invalid record is ignored; an invalid record of a setting also counts as
    /// damage.
    pub(crate) fn restore<const N: usize>(
        &mut self,
        record: &Record,
        settings: &mut Settings<N>,
        interpreter: &mut Interpreter<N>,
    ) {
        match record.key {
            0..KEY_OFFSETS | KEY_DIALECT => self.restore_setting(record, settings),
            KEY_TOOLS..KEY_STARTUP => {
                if let Some((number, offset)) = record.value.split_first_chunk()
                    && let Some(offset) = position_of(offset)
                {
                    let tool = Tool { number: u32::from_le_bytes(*number), offset };
                    interpreter.tools_mut().put(usize::from(record.key - KEY_TOOLS), tool);
                }
            }
            KEY_OFFSETS..KEY_TOOLS => {
                if let Some(position) = position_of(&record.value)
                    && let Some(offset) = StoredOffset::all().nth(usize::from(record.key - KEY_OFFSETS))
                {
                    interpreter.set_stored(offset, position);
                    if let StoredOffset::System(system) = offset {
                        interpreter.set_angle(system, angle_of(&record.value));
                    }
                }
            }
            KEY_STARTUP..KEY_BUILD_INFO => {
                if let Some(line) = self.startup_lines.get_mut(usize::from(record.key - KEY_STARTUP)) {
                    *line = heapless::Vec::from_slice(&record.value).unwrap_or_default();
                }
            }
            KEY_BUILD_INFO => self.build_info = heapless::Vec::from_slice(&record.value).unwrap_or_default(),
            // A number beyond the last macro line is an error, which is ignored.
            KEY_MACROS..KEY_DIALECT => {
                let _ = interpreter.set_macro_line(usize::from(record.key - KEY_MACROS), &record.value);
            }
            STORE_DAMAGED => self.damage = Damage::Untold,
            _ => {}
        }
    }

    /// Restores a setting. A setting whose stored value is invalid keeps its default, and counts as damage.
    fn restore_setting<const N: usize>(&mut self, record: &Record, settings: &mut Settings<N>) {
        // A value of another length becomes NaN, which is invalid for every setting.
        let value = record.value.as_slice().try_into().map_or(f32::NAN, f32::from_le_bytes);
        if !settings.restore(setting_of(record.key), value) {
            self.damage = Damage::Untold;
            // A key beyond the capacity is not corrected, so it counts as damage again at the next power-up.
            let _ = self.refused.push(record.key);
        }
    }

    // Changes on their way to the store

    /// Returns whether a change waits to be handed to the store.
    pub(crate) fn has_next(&self) -> bool {
        !self.stores.is_empty()
    }

    /// Removes and returns the oldest change that waits to be handed to the store.
    pub(crate) fn next_store(&mut self) -> Option<Store> {
        self.stores.pop_front()
    }

    /// Counts an answer of the store. `stored`: `true` if the change was stored. At the last awaited answer, returns
    /// `true` if at least one of the changes could not be stored.
    pub(crate) fn answered(&mut self, stored: bool) -> bool {
        self.unstored = self.unstored.saturating_sub(1);
        self.failed |= !stored;
        self.are_stored() && core::mem::take(&mut self.failed)
    }

    /// Returns whether the store has answered all changes, as stored or failed.
    pub(crate) fn are_stored(&self) -> bool {
        self.unstored == 0
    }

    /// Queues a change for the store. There is room, because one command makes at most four changes, and the next
    /// command is read only after the store has answered them. After a reset the next command can be read earlier; if
    /// there is no room in that case, the change counts as one that could not be stored.
    fn hand_over(&mut self, store: Store) {
        if self.has_store {
            match self.stores.push_back(store) {
                Ok(()) => self.unstored += 1,
                Err(_) => self.failed = true,
            }
        }
    }

    fn save(&mut self, key: u16, value: &[u8]) {
        if let Ok(value) = heapless::Vec::from_slice(value) {
            self.hand_over(Store::Put(Record { key, value }));
        }
    }

    fn remove(&mut self, keys: core::ops::Range<u16>) {
        self.hand_over(Store::Remove { from: keys.start, until: keys.end });
    }

    /// Stores the value that setting `number` has in `settings`. The dialect has a key of its own.
    pub(crate) fn save_setting<const N: usize>(&mut self, number: u16, settings: &Settings<N>) {
        self.save_setting_as(if number == DIALECT { KEY_DIALECT } else { number }, settings);
    }

    fn save_setting_as<const N: usize>(&mut self, key: u16, settings: &Settings<N>) {
        if let Some(value) = settings.by_number(setting_of(key)) {
            self.save(key, &value.to_le_bytes());
        }
    }

    /// Stores the value of `$20` (soft limits) that belongs to a new value of `$22` (homing), unless the stored value
    /// can stay (see [`Settings::soft_limits_before_homing`]). Call it before the new `$22` is stored. `were_on`:
    /// `true` if soft limits were on before `$22` was changed.
    pub(crate) fn save_soft_limits_before_homing<const N: usize>(&mut self, settings: &Settings<N>, were_on: bool) {
        if let Some(value) = settings.soft_limits_before_homing(were_on) {
            self.save(SOFT_LIMITS, &value.to_le_bytes());
        }
    }

    /// Stores a coordinate system, G28, G30 or an entry of the tool table after a change.
    #[inline(never)]
    pub(crate) fn save_offset<const N: usize>(&mut self, offset: StoredOffset, interpreter: &Interpreter<N>) {
        let mut bytes: heapless::Vec<u8, 52> = heapless::Vec::new();
        let mut position = interpreter.offsets().stored(offset);
        let key = if let StoredOffset::Tool(number) = offset {
            let _ = bytes.extend_from_slice(&number.to_le_bytes());
            position = interpreter.tools().offset(number).unwrap_or_default();
            interpreter.tools().slot(number).map(|slot| KEY_TOOLS + slot as u16)
        } else {
            StoredOffset::all().position(|o| o == offset).map(|index| KEY_OFFSETS + index as u16)
        };
        // X, Y and Z are always written; A, B and C only up to the last one that is not 0. So a machine that uses three
        // axes has the same records in every build.
        let places = position.0.iter().rposition(|value| *value != Coordinate::ZERO).map_or(0, |last| last + 1);
        for value in position.iter().take(places.max(LINEAR)) {
            let _ = bytes.extend_from_slice(&value.0.to_le_bytes());
        }
        if let StoredOffset::System(system) = offset {
            // The angle comes last and is shorter than a coordinate, so firmware without rotations ignores it.
            let angle = interpreter.offsets().angle(system);
            if angle != Angle::ZERO {
                let _ = bytes.extend_from_slice(&angle.0.to_le_bytes());
            }
        }
        if let Some(key) = key {
            self.save(key, &bytes);
        }
    }

    /// Removes the record of a tool table entry that has become free.
    pub(crate) fn remove_tool(&mut self, slot: usize) {
        let key = KEY_TOOLS + slot as u16;
        self.remove(key..key + 1);
    }

    /// Removes the records of everything that this `$RST` resets to defaults.
    pub(crate) fn forget(&mut self, what: Restore) {
        if what == Restore::All {
            self.startup_lines = [heapless::Vec::new(), heapless::Vec::new()];
            self.build_info.clear();
        }
        self.remove(match what {
            Restore::Settings => 0..KEY_OFFSETS,
            Restore::Coordinates => KEY_OFFSETS..KEY_STARTUP,
            Restore::All => 0..KEY_DIALECT,
        });
    }

    // Stored texts

    /// Returns whether records survive power-off.
    pub(crate) fn has_store(&self) -> bool {
        self.has_store
    }

    /// Returns the startup line with this index, 0 or 1; `None` for any other index.
    pub(crate) fn startup_line(&self, index: usize) -> Option<&StoredText> {
        self.startup_lines.get(index)
    }

    /// Stores a startup line (`$N=`).
    pub(crate) fn save_startup_line(&mut self, index: usize, line: StoredText) {
        self.save(KEY_STARTUP + index as u16, &line);
        if let Some(slot) = self.startup_lines.get_mut(index) {
            *slot = line;
        }
    }

    /// Keeps a startup line while it is executed. If the line is valid, [`Records::save_validated`] stores it
    /// afterwards.
    pub(crate) fn validate(&mut self, line: StoredText) {
        self.validated = line;
    }

    /// Stores the line that [`Records::validate`] has kept, as the startup line with this index.
    pub(crate) fn save_validated(&mut self, index: usize) {
        let line = self.validated.clone();
        self.save_startup_line(index, line);
    }

    /// Stores a macro line (`$M=`). If the line is empty, its record is removed.
    pub(crate) fn save_macro(&mut self, index: usize, line: &StoredText) {
        let key = KEY_MACROS + index as u16;
        if line.is_empty() {
            self.remove(key..key + 1);
        } else {
            self.save(key, line);
        }
    }

    /// Returns the build info text (`$I`).
    pub(crate) fn build_info(&self) -> &StoredText {
        &self.build_info
    }

    /// Stores the build info text (`$I=`).
    pub(crate) fn save_build_info(&mut self, text: StoredText) {
        self.save(KEY_BUILD_INFO, &text);
        self.build_info = text;
    }

    // Damaged records

    /// Returns whether stored settings were damaged and have not been confirmed.
    pub(crate) fn are_damaged(&self) -> bool {
        self.damage != Damage::None
    }

    /// Requires the settings to be listed again, because a new host was greeted.
    pub(crate) fn host_greeted(&mut self) {
        if self.are_damaged() {
            self.damage = Damage::Untold;
        }
    }

    /// Notes that `$$` has been answered. Returns whether settings were damaged.
    pub(crate) fn listed(&mut self, now: Instant) -> bool {
        let damaged = self.are_damaged();
        if damaged {
            self.damage = Damage::Listed(now);
        }
        damaged
    }

    /// Confirms the settings as they are, if somebody has had time to read them: clears the damage in the store, and
    /// replaces the invalid stored values. Returns whether there was enough time.
    pub(crate) fn confirm<const N: usize>(&mut self, now: Instant, settings: &Settings<N>) -> bool {
        let looked = matches!(self.damage, Damage::Listed(at) if now >= at + LOOKING);
        if looked {
            self.damage = Damage::None;
            self.remove(STORE_DAMAGED..STORE_DAMAGED + 1);
            while let Some(key) = self.refused.pop() {
                self.save_setting_as(key, settings);
            }
        }
        looked
    }
}

/// Returns the number of the setting that is stored in the record with this key.
const fn setting_of(key: u16) -> u16 {
    if key == KEY_DIALECT { DIALECT } else { key }
}

/// Returns the position in a record; `None` if it is invalid.
fn position_of<const N: usize>(bytes: &[u8]) -> Option<PerAxis<Coordinate, N>> {
    let mut position = PerAxis::default();
    for (axis, bytes) in Axis::of_machine::<N>().zip(bytes.chunks_exact(8)) {
        position.set(axis, Coordinate(i64::from_le_bytes(bytes.try_into().ok()?)));
    }
    position.iter().all(|c| c.in_range()).then_some(position)
}

/// Returns the angle in a record; zero if there is none or if it is invalid.
fn angle_of(bytes: &[u8]) -> Angle {
    let angle =
        bytes.chunks_exact(8).remainder().try_into().map_or(Angle::ZERO, |bytes| Angle(i32::from_le_bytes(bytes)));
    if Angle::of(angle.degrees()) == angle { angle } else { Angle::ZERO }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcode::CoordinateSystem;
    use crate::units::Decimal;

    fn at(seconds: u64) -> Instant {
        Instant::from_ticks(0) + Duration::secs(seconds)
    }

    /// Hands the changes of `records` to the store. Returns the state after a restart with these records.
    fn restarted(records: &mut Records) -> (Records, Settings<3>, Interpreter<3>) {
        let mut after = (Records::new(true), Settings::default(), Interpreter::default());
        while let Some(store) = records.next_store() {
            if let Store::Put(record) = store {
                after.0.restore(&record, &mut after.1, &mut after.2);
            }
            records.answered(true);
        }
        after
    }

    #[test]
    fn what_is_saved_is_restored() {
        let mut records = Records::new(true);
        let mut settings = Settings::<3>::default();
        settings.restore(DIALECT, 0.0);
        records.save_setting(DIALECT, &settings);
        records.save_startup_line(1, heapless::Vec::from_slice(b"G21").unwrap());
        records.save_build_info(heapless::Vec::from_slice(b"mill").unwrap());
        assert!(!records.are_stored());
        let (after, settings, _) = restarted(&mut records);
        assert!(records.are_stored());
        assert_eq!(settings.value(Key::Dialect), 0.0);
        assert_eq!(after.startup_line(1).unwrap(), b"G21");
        assert_eq!(after.build_info(), b"mill");
        assert!(after.startup_line(0).unwrap().is_empty() && after.startup_line(2).is_none());
    }

    /// Four changes wait, as after a reset during a confirmation. After one of them has been stored, a command makes
    /// two more changes. One of these finds no room, and the failure is reported.
    #[test]
    fn a_change_that_finds_no_room_is_told() {
        let mut records = Records::new(true);
        let settings = Settings::<3>::default();
        for number in [0, 1, 2, 3] {
            records.save_setting(number, &settings);
        }
        assert!(records.next_store().is_some() && !records.answered(true));
        records.save_setting(20, &settings);
        records.save_setting(22, &settings);
        let mut told = 0;
        while records.next_store().is_some() {
            told += u32::from(records.answered(true));
        }
        assert!(records.are_stored());
        assert_eq!(told, 1);
    }

    #[test]
    fn offsets_come_back_and_those_out_of_range_do_not() {
        let mut records = Records::new(true);
        let (_, mut settings, mut interpreter) = restarted(&mut records);
        let position = PerAxis([Coordinate::mm(1), Coordinate::mm(-2), Coordinate::mm(3)]);
        interpreter.set_stored(StoredOffset::G28, position);
        records.save_offset(StoredOffset::G28, &interpreter);
        let (_, _, after) = restarted(&mut records);
        assert_eq!(after.offsets().stored(StoredOffset::G28), position);
        let value = heapless::Vec::from_slice(&i64::MAX.to_le_bytes()).unwrap();
        records.restore(&Record { key: KEY_OFFSETS, value }, &mut settings, &mut interpreter);
        assert_eq!(interpreter.offsets().stored(StoredOffset::all().next().unwrap()), PerAxis::default());
    }

    /// Rotations are restored after a restart. Older records have no angle, and older firmware ignores the angle in
    /// newer records.
    #[test]
    fn rotations_come_back() {
        let mut records = Records::new(true);
        let (_, mut settings, mut interpreter) = restarted(&mut records);
        let system = CoordinateSystem::G55;
        let which = StoredOffset::System(system);
        let position = PerAxis([Coordinate::mm(1), Coordinate::mm(-2), Coordinate::mm(3)]);
        interpreter.set_stored(which, position);
        let angle = Angle::of(Decimal::from_int(-30));
        for (set, length) in [(Angle::ZERO, 24), (angle, 28)] {
            interpreter.set_angle(system, set);
            records.save_offset(which, &interpreter);
            let Some(Store::Put(record)) = records.stores.front().cloned() else { panic!("no record") };
            assert_eq!(record.value.len(), length);
            assert_eq!(position_of(&record.value), Some(position));
            let (_, _, after) = restarted(&mut records);
            assert_eq!((after.offsets().stored(which), after.offsets().angle(system)), (position, set));
        }
        // An invalid angle is ignored.
        let mut value = heapless::Vec::from_slice(&[0; 24]).unwrap();
        value.extend_from_slice(&i32::MAX.to_le_bytes()).unwrap();
        records.restore(&Record { key: KEY_OFFSETS + 1, value }, &mut settings, &mut interpreter);
        assert_eq!(interpreter.offsets().angle(system), Angle::ZERO);
    }

    /// Records written by a three-axis build are valid for four axes, and a four-axis build writes the same length if A
    /// is 0.
    #[test]
    fn records_of_three_axes_and_of_four() {
        let places = [Coordinate::mm(1), Coordinate::mm(-2), Coordinate::mm(3)];
        let (mut of_three, mut of_four) = (Interpreter::<3>::default(), Interpreter::<4>::default());
        let [x, y, z] = places;
        let which = StoredOffset::System(CoordinateSystem::G54);
        let written = |records: &mut Records| match records.next_store() {
            Some(Store::Put(record)) => record,
            other => panic!("{other:?}"),
        };
        for angle in [Angle::ZERO, Angle::of(Decimal::from_int(30))] {
            let mut records = Records::new(true);
            of_three.set_stored(which, PerAxis(places));
            of_three.set_angle(CoordinateSystem::G54, angle);
            records.save_offset(which, &of_three);
            let three = written(&mut records);
            records.restore(&three, &mut Settings::<4>::default(), &mut of_four);
            assert_eq!(of_four.offsets().stored(which), PerAxis([x, y, z, Coordinate::ZERO]));
            assert_eq!(of_four.offsets().angle(CoordinateSystem::G54), angle);
            records.save_offset(which, &of_four);
            assert_eq!(written(&mut records), three);
            of_four.set_stored(which, PerAxis([x, y, z, Coordinate::mm(90)]));
            records.save_offset(which, &of_four);
            let four = written(&mut records);
            let (mut again, mut fewer) = (Interpreter::<4>::default(), Interpreter::<3>::default());
            records.restore(&four, &mut Settings::<4>::default(), &mut again);
            records.restore(&four, &mut Settings::<3>::default(), &mut fewer);
            assert_eq!(again.offsets().stored(which), of_four.offsets().stored(which));
            assert_eq!(
                (fewer.offsets().stored(which), fewer.offsets().angle(CoordinateSystem::G54)),
                (PerAxis(places), angle)
            );
        }
    }

    #[test]
    fn without_a_store_nothing_waits_for_one() {
        let mut records = Records::new(false);
        records.save_build_info(heapless::Vec::new());
        assert!(records.are_stored() && records.next_store().is_none());
    }

    #[test]
    fn a_failure_is_told_once() {
        let mut records = Records::new(true);
        records.forget(Restore::All);
        records.forget(Restore::All);
        assert!(!records.answered(false) && !records.are_stored());
        assert!(records.answered(true) && records.are_stored());
        records.forget(Restore::All);
        assert!(!records.answered(true));
    }

    #[test]
    fn records_of_settings_that_cannot_be_are_replaced_when_that_is_confirmed() {
        let mut records = Records::new(true);
        let (_, mut settings, mut interpreter) = restarted(&mut records);
        let mut restore = |records: &mut Records, key, value: &[u8]| {
            let value = heapless::Vec::from_slice(value).unwrap();
            records.restore(&Record { key, value }, &mut settings, &mut interpreter);
            records.are_damaged()
        };
        // These settings do not exist here, but can exist in other builds.
        assert!(!restore(&mut records, 999, &[1]) && !restore(&mut records, 103, &(-1_f32).to_le_bytes()));
        assert!(restore(&mut records, 100, &[0; 5]));
        for key in [KEY_DIALECT, DIALECT, 21] {
            assert!(restore(&mut records, key, &7_f32.to_le_bytes()));
        }
        assert!(records.listed(at(0)) && records.confirm(at(2), &settings));
        let changes: Vec<_> = core::iter::from_fn(|| records.next_store()).collect();
        let put = |key, value: f32| {
            Store::Put(Record { key, value: heapless::Vec::from_slice(&value.to_le_bytes()).unwrap() })
        };
        let cleaned = Store::Remove { from: STORE_DAMAGED, until: STORE_DAMAGED + 1 };
        assert_eq!(changes, [cleaned, put(DIALECT, 1.0), put(KEY_DIALECT, 1.0), put(100, 250.0)]);
    }

    #[test]
    fn damage_is_confirmed_by_somebody_who_has_looked() {
        let mut records = Records::new(true);
        assert!(!records.listed(at(0)));
        let damage = Record { key: STORE_DAMAGED, value: heapless::Vec::new() };
        let (_, mut settings, mut interpreter) = restarted(&mut records);
        records.restore(&damage, &mut settings, &mut interpreter);
        assert!(records.are_damaged() && !records.confirm(at(9), &settings));
        assert!(records.listed(at(10)));
        assert!(!records.confirm(at(11), &settings), "too fast to have read them");
        records.host_greeted();
        assert!(!records.confirm(at(20), &settings), "another host has not seen them");
        assert!(records.listed(at(20)) && records.confirm(at(22), &settings));
        assert!(!records.are_damaged());
        let store = Store::Remove { from: STORE_DAMAGED, until: STORE_DAMAGED + 1 };
        assert_eq!(records.next_store(), Some(store));
    }
}
