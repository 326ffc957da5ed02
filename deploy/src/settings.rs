//! `--set` beside the flags that set keys of their own.

use anyhow::Result;
use run::config::set_by_user;
use terminal::refusal::wrong_usage;

/// Refuses settings that say otherwise than `flags`, which are `key=value`, too.
///
/// # Errors
/// Of wrong usage, naming the key and both values.
pub(crate) fn refuse_contradiction(flags: &[String], settings: &[String]) -> Result<()> {
    let set = set_by_user(settings)?;
    for (key, value) in set_by_user(flags)? {
        if let Some(other) = set.get(&key).filter(|other| **other != value) {
            return Err(wrong_usage(format!(
                "--set {key}={other}: expected what the flag says, {key}={value}, or no such flag"
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_has_one_value() {
        let refused = |flag: &str, setting: &str| {
            let words = |text: &str| vec![text.to_owned()];
            refuse_contradiction(&words(flag), &words(setting)).map_err(|error| error.to_string())
        };
        assert_eq!(refused("steps=5", "steps = 5"), Ok(()));
        assert_eq!(refused("steps=5", "seed=6"), Ok(()));
        let said = refused("steps=5", "steps = 6").unwrap_err();
        assert!(said.contains("--set steps=6") && said.contains("says, steps=5"), "{said}");
        assert!(refused("steps=5", "steps").is_err());
    }
}
