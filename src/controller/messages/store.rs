//! Messages to the settings store: a record of bytes under a key, and a change of records.

/// Key of the record by which a damaged store reports that other records may be lost. The record has no value. The
/// store reports it at each power-up, until the operator has confirmed the settings and the controller removes the
/// record.
pub const STORE_DAMAGED: u16 = 65_534;

/// A record of the settings store: a key and up to 100 bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// The key; its meaning is defined by the controller.
    pub key: u16,
    /// The value, in the format that the controller uses for this key.
    pub value: heapless::Vec<u8, 100>,
}

/// A change of the settings store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Store {
    /// Writes a record, replacing the record with the same key.
    Put(Record),
    /// Removes the records of a range of keys.
    Remove {
        /// First key.
        from: u16,
        /// First key after the range; its record stays.
        until: u16,
    },
}
