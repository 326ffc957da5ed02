//! Checks `--set` against the flags that set keys of their own.

use anyhow::Result;
use run::config::set_by_user;
use terminal::refusal::wrong_usage;

/// Refuses `settings` that contradict `flags`; both have the form `key=value`.
///
/// # Errors
/// Wrong usage, naming the key and both values.
pub(crate) fn refuse_contradiction(flags: &[String], settings: &[String]) -> Result<()> {
    let set = set_by_user(settings)?;
    for (key, value) in set_by_user(flags)? {
        if let Some(other) = set.get(&key).filter(|other| **other != value) {
            return Err(wrong_usage(format!(
                "--set {key}={other}: expected {key}={value}, as the flag says, or no flag for this key"
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
        assert!(
            said.contains("--set steps=6") && said.contains("steps=5, as the flag says"),
            "{said}"
        );
        assert!(refused("steps=5", "steps").is_err());
    }
}
