//! TOML tables, such as a run's configuration: merging them, parsing a setting, flattening, and finding differences.

use std::collections::{BTreeMap, BTreeSet};

use toml::{Table, Value};

/// The sections of a configuration that do not affect results.
pub const CHANGES_NO_RESULT: [&str; 3] = ["resources", "checkpoint", "log"];

/// Prefix of the keys with the hashes of the user's Python modules. The environment itself checks them when a run is
/// resumed.
pub const MODULES: &str = "environment.sources.";

/// Merges `changes` into `table`, table by table. An integer that replaces a float becomes one, so that `2` and `2.0`
/// are the same configuration.
pub fn merge(table: &mut Table, changes: Table) {
    for (key, change) in changes {
        match (table.get_mut(&key), change) {
            (Some(Value::Table(old)), Value::Table(new)) => merge(old, new),
            (Some(Value::Float(old)), Value::Integer(new)) => *old = new as f64,
            (_, change) => {
                table.insert(key, change);
            }
        }
    }
}

/// Text for the value of a key that a table lacks.
pub const ABSENT: &str = "nothing";

/// Parses `a.b.c=value`. A value that is not valid TOML is taken as a string.
///
/// # Errors
/// Says what is wrong with the key, or that there is no `=`.
pub fn parse_setting(setting: &str) -> Result<Table, String> {
    let (key, value) = setting.split_once('=').ok_or("expected key=value, found no `=`")?;
    let line = format!("{key} = {value}");
    let quoted = || format!("{key} = {}", Value::String(value.to_owned()));
    line.parse::<Table>()
        .or_else(|_| quoted().parse::<Table>())
        .map_err(|error| error.message().to_owned())
}

/// Returns the values of a table and its nested tables, by dotted key.
pub fn flat(table: &Table) -> BTreeMap<String, Value> {
    let mut values = BTreeMap::new();
    for (key, value) in table {
        match value {
            Value::Table(inner) => {
                let named = |(rest, value)| (format!("{key}.{rest}"), value);
                values.extend(flat(inner).into_iter().map(named));
            }
            value => drop(values.insert(key.clone(), value.clone())),
        }
    }
    values
}

/// Returns the values of a configuration that affect results, by dotted key.
pub fn deciding(table: &Table) -> BTreeMap<String, Value> {
    let mut table = table.clone();
    table.retain(|part, _| !CHANGES_NO_RESULT.contains(&part));
    flat(&table)
}

/// Returns the keys that affect results and differ between two configurations, in order, with both values.
pub fn result_differences(expected: &Table, found: &Table) -> Vec<(String, [String; 2])> {
    let both = [deciding(expected), deciding(found)];
    let keys: BTreeSet<&String> = both.iter().flat_map(BTreeMap::keys).collect();
    let shown = |key: &String| {
        both.each_ref().map(|values| values.get(key).map_or(ABSENT.to_owned(), Value::to_string))
    };
    let is_other = |key: &&String| both[0].get(*key) != both[1].get(*key);
    keys.into_iter().filter(is_other).map(|key| (key.clone(), shown(key))).collect()
}
