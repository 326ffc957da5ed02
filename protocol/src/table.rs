//! TOML tables: one laid over another, one made of a setting, one without its nesting.

use std::collections::BTreeMap;

use toml::{Table, Value};

/// Lays `changes` over `table`, table by table.
pub(crate) fn merge(table: &mut Table, changes: Table) {
    for (key, change) in changes {
        match (table.get_mut(&key), change) {
            (Some(Value::Table(old)), Value::Table(new)) => merge(old, new),
            (_, change) => {
                table.insert(key, change);
            }
        }
    }
}

/// Reads `a.b.c=value`; a value that is no TOML is taken as text.
pub(crate) fn parse_setting(setting: &str) -> Result<Table, String> {
    let (key, value) = setting.split_once('=').ok_or("expected key=value, found no `=`")?;
    let line = format!("{key} = {value}");
    let quoted = || format!("{key} = {value:?}");
    line.parse::<Table>()
        .or_else(|_| quoted().parse::<Table>())
        .map_err(|error| error.message().to_owned())
}

/// The values of a table and of those in it, by dotted key.
pub(crate) fn flat(table: &Table) -> BTreeMap<String, Value> {
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
