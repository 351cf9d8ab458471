//! Every recorded exchange that this controller answers otherwise, and why.

/// A record that is answered otherwise.
pub struct Difference {
    pub group: &'static str,
    pub n: u64,
    /// What is answered; `None` where that depends on the moment.
    pub answers: Option<&'static [&'static str]>,
    #[allow(dead_code, reason = "for the reader")]
    pub why: &'static str,
}

const fn differs(group: &'static str, n: u64, answers: &'static [&'static str], why: &'static str) -> Difference {
    Difference { group, n, answers: Some(answers), why }
}

pub const DIFFERENCES: &[Difference] =
    &[differs("02_settings", 11, &["error:3"], "A22: whole-number settings are checked and do not wrap at 8 bits")];
