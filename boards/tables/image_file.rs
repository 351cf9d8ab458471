//! Writes a pin table into an image of the firmware: an ELF file, a `.hex`, a `.dfu` or a `.bin`. Nothing changes in
//! the file except the bytes of the table and the file's own checksums.

use crc::{CRC_32_JAMCRC, Crc};
use ihex::{Reader, Record};
use oxmill_boards::pin_table::{PinTable, SIZE};

/// Length of the suffix of a `.dfu` file, whose last four bytes are its checksum (USB DFU 1.1, appendix B).
const DFU_SUFFIX: usize = 16;
const DFU_SUM: Crc<u32> = Crc::<u32>::new(&CRC_32_JAMCRC);

/// Returns the image with its table replaced by `table`.
///
/// # Errors
///
/// Returns an error if the file is damaged, if it has no intact table or more than one, or if `table` is for another
/// image.
pub fn write(image: &[u8], table: &PinTable) -> Result<Vec<u8>, String> {
    if image.first() == Some(&b':') {
        return write_hex(image, table);
    }
    let mut bytes = image.to_vec();
    let is_dfu = image.starts_with(b"DfuSe");
    let (rest, sum) = image.split_at(image.len().saturating_sub(4));
    if is_dfu && (image.len() < DFU_SUFFIX || DFU_SUM.checksum(rest).to_le_bytes() != sum) {
        return Err("the .dfu file is damaged: its checksum is wrong".into());
    }
    put(&mut bytes, table)?;
    if is_dfu {
        let (rest, sum) = bytes.split_at_mut(image.len() - 4);
        sum.copy_from_slice(&DFU_SUM.checksum(rest).to_le_bytes());
    }
    Ok(bytes)
}

/// Returns the pin table in an image that is an ELF file, a `.dfu` or a `.bin`; `None` if it has no intact one.
pub fn table(image: &[u8]) -> Option<PinTable> {
    find(image).map(|(_, table)| table)
}

/// Replaces the pin table in `bytes` by `table`. Returns an error if `bytes` have no intact pin table, or more than
/// one, or if their table is for another image than `table`.
fn put(bytes: &mut [u8], table: &PinTable) -> Result<(), String> {
    let Some((at, own)) = find(bytes) else {
        return Err("the file has no intact pin table: is it an undamaged image of Oxmill?".into());
    };
    if own.image() != table.image() {
        return Err("the table is for another image: its entry `image` must name the image of the file".into());
    }
    if bytes.get(at + SIZE..).and_then(find).is_some() {
        return Err("the file has more than one pin table: take the image of one board".into());
    }
    if let Some(place) = bytes.get_mut(at..at + SIZE) {
        place.copy_from_slice(table.bytes());
    }
    Ok(())
}

/// Returns the index of the first intact table in the bytes, and the table. Checks the checksum at each index. The
/// first bytes of a table would not be enough to find it: the program's code compares with these bytes, so they also
/// occur there.
fn find(bytes: &[u8]) -> Option<(usize, PinTable)> {
    let whole = |bytes: &[u8]| bytes.try_into().map(PinTable::from_bytes).ok().filter(PinTable::is_intact);
    bytes.windows(SIZE).enumerate().find_map(|(at, window)| Some((at, whole(window)?)))
}

/// Writes the table into an Intel HEX file, as [`write`] does. Joins the data of all records, replaces the table in
/// them, and writes the data back into the same records.
fn write_hex(image: &[u8], table: &PinTable) -> Result<Vec<u8>, String> {
    let text = std::str::from_utf8(image).map_err(|_| "the .hex file is damaged: it is no text")?;
    let records: Result<Vec<Record>, _> = Reader::new(text).collect();
    let mut records = records.map_err(|error| format!("the .hex file is damaged: {error}"))?;
    let data = |record: &Record| matches!(record, Record::Data { .. });
    let mut bytes: Vec<u8> = Vec::new();
    for record in records.iter().filter(|record| data(record)) {
        if let Record::Data { value, .. } = record {
            bytes.extend(value);
        }
    }
    put(&mut bytes, table)?;
    let mut rest = bytes.as_slice();
    for record in &mut records {
        if let Record::Data { value, .. } = record {
            let (own, others) = rest.split_at(value.len());
            value.copy_from_slice(own);
            rest = others;
        }
    }
    let text = ihex::create_object_file_representation(&records).map_err(|error| error.to_string())?;
    Ok((text + "\n").into_bytes())
}
