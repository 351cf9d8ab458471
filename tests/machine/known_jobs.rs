//! Twelve jobs whose end positions and steps are recorded in `tests/jobs/digests.txt`. The steps are recorded as two
//! digests: one covers their times, one only their order. `cargo test-target` compares the firmware on QEMU with the
//! same digests, so simulator and firmware make the same steps. After an intended change of motion, rewrite the
//! digests: `OXMILL_WRITE_DIGESTS=1 cargo test --test machine known_jobs`.

use oxmill_simulator::{JobText, Options, Simulator, boards};
use std::fmt::Write;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

fn jobs(root: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = fs::read_dir(root.join("tests/jobs"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "nc"))
        .collect();
    files.extend(["five_circles", "house"].map(|name| root.join(format!("examples/{name}.nc"))));
    files.sort_by_key(|path| path.file_name().map(std::ffi::OsStr::to_owned));
    files
}

fn run(file: &Path) -> String {
    let mut mill = Simulator::new(Options { board: boards::QEMU_MPS2, ..Options::default() });
    mill.take_output();
    mill.begin_job();
    mill.load_job(JobText::new(Cursor::new(fs::read(file).unwrap())));
    assert!(mill.run_until_idle(), "{}", file.display());
    let answers = mill.take_output();
    assert!(!answers.contains("error:"), "{}: {answers}", file.display());
    let digest = mill.trace().digest();
    let name = file.file_stem().unwrap().to_string_lossy();
    let [x, y, z] = mill.machine().position();
    format!("{name:<14} time {:016x} order {:016x} steps {x} {y} {z}", digest.time_hash(), digest.order_hash())
}

#[test]
fn steps_are_what_is_written_down() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let files = jobs(root);
    assert_eq!(files.len(), 12);
    let mut text = String::new();
    for file in files {
        writeln!(text, "{}", run(&file)).unwrap();
    }
    let path = root.join("tests/jobs/digests.txt");
    if std::env::var_os("OXMILL_WRITE_DIGESTS").is_some() {
        fs::write(&path, text).unwrap();
        return;
    }
    let known = fs::read_to_string(&path).unwrap();
    assert_eq!(text, known, "the steps of these jobs have changed; if they should, see the head of {}", file!());
}
