//! Messages to the settings store: a record of bytes under a key, and a change of records.

/// Key of the record by which a store tells that it has been damaged and has lost others. It is empty, and holds until it is
/// removed.
pub const STORE_DAMAGED: u16 = 65_534;

/// A record of the settings store: a key and up to 100 bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// What is stored; the meaning belongs to the controller.
    pub key: u16,
    /// The value.
    pub value: heapless::Vec<u8, 100>,
}

/// A change of the settings store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Store {
    /// Write a record, replacing the one with its key.
    Put(Record),
    /// Remove all records with keys from `from` to `until - 1`.
    Remove {
        /// First key.
        from: u16,
        /// First key that stays.
        until: u16,
    },
}
