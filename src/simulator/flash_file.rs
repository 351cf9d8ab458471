//! A flash image in a file (`--store`), locked while in use. It has the sectors one after the other, 16 KiB each, as a
//! debug probe would read them. Every word that the settings log writes is written to the file at once and separately.

use crate::files::lock;
use crate::store::{IMAGE, Kept, Store, Unusable};
use anyhow::{Context, Result, anyhow};
use std::fs::OpenOptions;
use std::io::{Read as _, Seek, SeekFrom, Write as _};
use std::path::Path;
use std::sync::Arc;

impl Store {
    /// Opens the store in a file. A missing or empty file becomes an empty store. The file stays locked while the store
    /// exists, because two writers would lose data.
    pub fn open(path: &Path) -> Result<Self> {
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .with_context(|| format!("cannot open the flash image {}", path.display()))?;
        lock(&file).with_context(|| format!("cannot lock the flash image {}", path.display()))?;
        let mut bytes = Vec::new();
        // Reading one byte more than the image size reveals a file that is too long.
        (&file)
            .take(IMAGE as u64 + 1)
            .read_to_end(&mut bytes)
            .with_context(|| format!("cannot read the flash image {}", path.display()))?;
        if bytes.is_empty() {
            bytes = Self::blank();
            if let Err(error) = file.write_all(&bytes) {
                // Empty the file, because the next run would reject a partial image.
                let _ = file.set_len(0);
                return Err(error).with_context(|| format!("cannot make the flash image {}", path.display()));
            }
        }
        let keep = move |change: Kept<'_>| match change {
            Kept::Bytes(at, bytes) => {
                let mut file = &file;
                file.seek(SeekFrom::Start(at as u64)).and_then(|_| file.write_all(bytes))
            }
            Kept::Sync => file.sync_data(),
        };
        Self::kept(&bytes, Arc::new(keep)).map_err(|why| match why {
            Unusable::Foreign(why) => why.context(format!("{} is not a flash image of this simulator", path.display())),
            Unusable::Log(failure) => anyhow!("the flash image {} cannot be used: {failure}", path.display()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use oxmill_controller::messages::Record;
    use oxmill_controller::messages::Store as Change;
    use oxmill_test_support::Folder;
    use std::fs;

    fn record(key: u16, value: &[u8]) -> Record {
        Record { key, value: heapless::Vec::from_slice(value).unwrap() }
    }

    #[test]
    fn records_outlive_the_store() {
        let folder = Folder::new();
        let path = folder.path().join("flash.img");
        let mut store = Store::open(&path).unwrap();
        for change in [
            Change::Put(record(7, b"old")),
            Change::Put(record(300, &[0, 255])),
            Change::Put(record(7, b"new")),
            Change::Put(record(3, b"x")),
            Change::Put(record(4, b"x")),
            Change::Put(record(5, b"")),
            Change::Remove { from: 3, until: 5 },
        ] {
            store.apply(&change).unwrap();
        }
        drop(store);
        let mut again = Store::open(&path).unwrap().records();
        again.sort_by_key(|r| r.key);
        assert_eq!(again, [record(5, b""), record(7, b"new"), record(300, &[0, 255])]);
        assert_eq!(fs::metadata(&path).unwrap().len(), 32 * 1024);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing else is left behind");
    }

    #[test]
    fn a_file_is_at_each_moment_what_the_flash_is() {
        let folder = Folder::new();
        let path = folder.path().join("flash.img");
        let mut store = Store::open(&path).unwrap();
        store.erase_ahead().unwrap();
        store.apply(&Change::Put(record(7, b"old"))).unwrap();
        store.cut_power_after(2, 0x0F0F_0F0F);
        assert!(store.apply(&Change::Put(record(7, b"newer"))).is_err());
        assert!(store.power_is_gone());
        assert!(store.apply(&Change::Put(record(7, b"newer"))).is_err(), "without power nothing is taken");
        assert_eq!(fs::read(&path).unwrap(), store.image());
        drop(store);
        assert_eq!(Store::open(&path).unwrap().records(), [record(7, b"old")]);
    }

    #[test]
    fn an_empty_file_is_an_erased_flash() {
        let folder = Folder::new();
        let path = folder.path().join("flash.img");
        fs::write(&path, []).unwrap();
        Store::open(&path).unwrap().apply(&Change::Put(record(7, b"new"))).unwrap();
        assert_eq!(Store::open(&path).unwrap().records(), [record(7, b"new")]);
    }

    #[test]
    fn a_file_is_the_flash_of_one_machine_at_a_time() {
        let folder = Folder::new();
        let path = folder.path().join("flash.img");
        let first = Store::open(&path).unwrap();
        let same = first.clone();
        drop(first);
        let refused = format!("{:#}", Store::open(&path).unwrap_err());
        assert!(refused.contains("in use by another oxmill"), "{refused}");
        drop(same);
        Store::open(&path).unwrap();
    }

    #[test]
    fn foreign_files_are_refused_and_not_overwritten() {
        let folder = Folder::new();
        let path = folder.path().join("flash.img");
        let image = vec![0x55_u8; IMAGE];
        let too_long = vec![0xFF_u8; IMAGE + 1];
        for bytes in [&b"G1 X1\n"[..], &image, &too_long] {
            fs::write(&path, bytes).unwrap();
            assert!(Store::open(&path).is_err(), "{} bytes", bytes.len());
            assert_eq!(fs::read(&path).unwrap(), bytes);
        }
    }
}
