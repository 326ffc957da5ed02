//! What the parser of configurations says, in words for users: it names types of Rust, which they need not know.

use toml::{Table, Value};

use super::RunConfig;

/// What the parser says of a value that is no name where it expects one of a few. It does not list these then.
const NO_NAME: &str = "expected string only";

/// Returns what is wrong with the table of a configuration: the place, and what was expected there.
pub(super) fn refusal(error: &toml::de::Error, table: &Table) -> String {
    let said = error.to_string();
    let (what, place) = parted(&said);
    let Some(place) = place else { return in_words(what) };
    let listed = if what.contains(NO_NAME) { with_names(table, place) } else { None };
    format!("in `{place}`: {}", in_words(listed.as_deref().unwrap_or(what)))
}

/// Parts a message from the key that the parser names in its last line.
fn parted(said: &str) -> (&str, Option<&str>) {
    let said = said.trim();
    let parts = said
        .rsplit_once('\n')
        .and_then(|(what, place)| Some((what, place.strip_prefix("in `")?.strip_suffix('`')?)));
    parts.map_or((said, None), |(what, place)| (what, Some(place)))
}

/// Returns what the parser says of the value at `place` if it is a name: then it lists the names that it knows.
fn with_names(table: &Table, place: &str) -> Option<String> {
    let mut table = table.clone();
    let mut parts = place.split('.');
    let last = parts.next_back()?;
    let mut inner = &mut table;
    for part in parts {
        inner = inner.get_mut(part)?.as_table_mut()?;
    }
    let value = inner.get_mut(last)?;
    *value = Value::String(value.to_string());
    let error = Value::Table(table).try_into::<RunConfig>().err()?;
    Some(parted(&error.to_string()).0.to_owned())
}

fn in_words(what: &str) -> String {
    let variant = what.strip_prefix("unknown variant `");
    if let Some((found, names)) = variant.and_then(|rest| rest.split_once("`, expected ")) {
        return format!("expected {}, found {found}", names.replace('`', ""));
    }
    let other = what.strip_prefix("invalid type: ").or(what.strip_prefix("invalid value: "));
    match other.and_then(|rest| rest.rsplit_once(", expected ")) {
        Some((found, expected)) => format!("expected {}, found {found}", kind(expected)),
        None => what.to_owned(),
    }
}

/// Returns what a user calls the values of a type.
fn kind(expected: &str) -> &str {
    match expected {
        "f32" | "f64" => "a number",
        "i32" | "i64" => "a whole number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number that is not negative",
        "a boolean" => "true or false",
        "a sequence" => "a list",
        "a map" | "map" => "a table",
        name if name.starts_with("struct ") => "a table",
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_of_rust_are_told_as_what_they_hold() {
        for (said, words) in [
            ("invalid type: integer `3`, expected struct PpoConfig", "a table, found integer `3`"),
            ("invalid type: string \"a, expected b\", expected f64", "a number, found string"),
            ("invalid value: integer `-1`, expected u64", "not negative, found integer `-1`"),
            ("unknown variant `x`, expected `a` or `b`", "expected a or b, found x"),
            ("unknown field `clipp`", "unknown field `clipp`"),
        ] {
            assert!(in_words(said).contains(words), "{}", in_words(said));
        }
    }

    #[test]
    fn a_message_is_parted_from_its_place() {
        assert_eq!(parted("no\nin `ppo.clip`\n"), ("no", Some("ppo.clip")));
        assert_eq!(parted("no\nat all\n"), ("no\nat all", None));
    }
}
