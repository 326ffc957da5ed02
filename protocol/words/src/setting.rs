//! The setting of an environment, such as where its starts and goals lie. The paper makes its tasks harder along these
//! axes (Section 4.3 and Appendix C).

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::Error;
use crate::dropped::shortened;
use crate::error::MESSAGE_CHARS;
use crate::table::merge;

/// The key of the factors that every continuous action is multiplied by, element by element, before it is clipped to
/// [-1, 1]. An empty list leaves actions as they are.
pub const ACTION_SCALE: &str = "action_scale";

/// The key that names the expert in a Python environment. It does not affect the environment.
pub const EXPERT: &str = "expert";

/// The key of the versions of the packages that a Python environment runs on.
pub const VERSIONS: &str = "versions";

/// The key that says how to make a Python environment. Rust environments have none.
pub const MAKE: &str = "make";

/// The key that says how a Python environment tells success.
pub const SUCCESS: &str = "success";

/// The key of the hashes of the user's own Python modules.
pub const SOURCES: &str = "sources";

/// The setting of an environment, by key. Only the environment knows its keys, their meaning and their defaults;
/// everything else only compares settings and passes them on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Setting(pub Table);

impl Setting {
    /// Converts an environment's own type to a setting.
    ///
    /// # Panics
    /// When the type is not a table of plain values.
    pub fn of(own: &impl Serialize) -> Setting {
        Setting(Table::try_from(own).expect("an environment's setting is a table"))
    }

    /// Converts the setting to an environment's own type.
    ///
    /// # Errors
    /// [`Error::Setting`], which names a key that is unknown or has a wrong value.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, Error> {
        Value::Table(self.0.clone()).try_into().map_err(|error: toml::de::Error| {
            let words = error.to_string().trim().replace('\n', " ");
            Error::Setting { message: shortened(&words, MESSAGE_CHARS) }
        })
    }

    /// Returns this setting with `changes` merged into it, key by key, also in nested tables.
    pub fn with(&self, changes: &Setting) -> Setting {
        let mut table = self.0.clone();
        merge(&mut table, changes.0.clone());
        Setting(table)
    }

    /// Returns the factor of each element of an action; empty if actions are not scaled.
    pub fn action_scale(&self) -> Vec<f32> {
        let numbers = self.0.get(ACTION_SCALE).and_then(Value::as_array);
        numbers.into_iter().flatten().filter_map(number).map(|number| number as f32).collect()
    }
}

/// Returns whether two values are equal. An integer equals the same number as a float.
pub fn is_same(one: &Value, other: &Value) -> bool {
    match (number(one), number(other)) {
        (Some(one), Some(other)) => one == other,
        _ => one == other,
    }
}

fn number(value: &Value) -> Option<f64> {
    value.as_float().or(value.as_integer().map(|number| number as f64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    struct Own {
        noise: f64,
        action_scale: Vec<f64>,
    }

    impl Default for Own {
        fn default() -> Own {
            Own { noise: 1.0, action_scale: Vec::new() }
        }
    }

    fn setting(text: &str) -> Setting {
        Setting(text.parse().unwrap())
    }

    #[test]
    fn an_environment_reads_and_completes_its_own() {
        let own: Own = setting("noise = 2").read().unwrap();
        assert_eq!(own, Own { noise: 2.0, ..Own::default() });
        assert_eq!(Setting::of(&own), setting("noise = 2.0\naction_scale = []"));
        let said = setting("nose = 2").read::<Own>().unwrap_err().to_string();
        assert!(
            said.contains("`nose`") && said.contains("noise") && !said.contains('\n'),
            "{said}"
        );
    }

    #[test]
    fn one_setting_lies_over_another() {
        let both = setting("a = 1\nb = 2").with(&setting("b = 3"));
        assert_eq!(both, setting("a = 1\nb = 3"));
        let both = setting("noise = 1.0").with(&setting("noise = 2"));
        assert_eq!(both, setting("noise = 2.0"));
        assert!(is_same(&Value::Integer(1), &Value::Float(1.0)));
        assert!(!is_same(&Value::Integer(1), &Value::String("1".to_owned())));
    }

    #[test]
    fn an_action_scale_is_known_to_all() {
        assert_eq!(setting("action_scale = [1, 0.5]").action_scale(), [1.0, 0.5]);
        assert!(setting("").action_scale().is_empty());
    }
}
