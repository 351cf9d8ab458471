//! Imports the settings of other controllers: the output of `$$` of Grbl and grblHAL, or a configuration file of
//! FluidNC. Each entry becomes one or more settings, or is listed as not taken with a reason. The command `oxmill
//! settings import` and the page use this module.

use crate::{import_dump, import_fluidnc};

pub use crate::import_list::{Import, LeftEntry, TakenSetting, Value};

/// Imports the text of a settings file. It can have the line ends of any system and a byte order mark.
///
/// # Errors
/// If the text is not of a known form; the error says why.
pub fn import(text: &str) -> Result<Import, String> {
    let text = text.strip_prefix('\u{FEFF}').unwrap_or(text).replace("\r\n", "\n").replace('\r', "\n");
    if import_fluidnc::is_configuration(&text) {
        return import_fluidnc::import(&text);
    }
    import_dump::import(&text).ok_or_else(|| {
        "it is neither the output of $$, with lines such as $110=500, nor a configuration of FluidNC, with a section axes:".into()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn settings(import: &Import) -> Vec<(u16, Value)> {
        let mut settings: Vec<_> = import.taken.iter().map(|taken| (taken.number, taken.value)).collect();
        settings.sort_by_key(|(number, _)| *number);
        settings
    }

    /// Generates a text that mixes entries of a FluidNC configuration, `$n=v` settings and arbitrary text.
    fn lines() -> impl Strategy<Value = String> {
        let key = prop::sample::select(vec![
            "axes",
            "x",
            "z",
            "a",
            "homing",
            "cycle",
            "mpos_mm",
            "motor0",
            "motor1",
            "step_pin",
            "soft_limits",
            "PWM",
            "speed_map",
            "kinematics",
            "CoreXY",
            "#",
            "\u{e9}",
        ]);
        let value =
            prop::sample::select(vec!["", "1", "0.5", "true", "gpio.1:low", "0=0% 9=100%", "NO_PIN", "\"#\" #"]);
        let entry = (0_usize..8, key, value).prop_map(|(indent, key, value)| format!("{:indent$}{key}: {value}", ""));
        let setting = (0_u32..1000, -9_i32..600).prop_map(|(number, value)| format!("${number}={value}"));
        prop::collection::vec(prop_oneof![entry, setting, ".{0,12}"], 0..40).prop_map(|lines| lines.join("\n"))
    }

    proptest! {
        /// No text causes a fault, and the written settings are read back as the same settings.
        #[test]
        fn what_is_written_is_read_again(text in lines(), is_file in any::<bool>()) {
            let text = if is_file { format!("axes:\n{text}") } else { text };
            let Ok(first) = import(&text) else { return Ok(()) };
            let again = import(&first.assignments()).unwrap_or_default();
            prop_assert!(again.left.is_empty());
            // A dump of Oxmill that has no setting of Oxmill's own looks like a dump of Grbl. If such a dump has a
            // resolution of A, importing it adds `$930=4`, so do not compare it.
            if first.what != "Oxmill" || first.taken.iter().any(|taken| taken.number >= 900) {
                prop_assert_eq!(settings(&again), settings(&first));
            }
        }
    }
}
