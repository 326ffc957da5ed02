//! What a method changes in the configuration of a task.

use protocol::Error;
use protocol::error::out_of_range;
use protocol::table::merge;
use toml::{Table, Value};

use super::{names, taken};

/// Returns what the method `name` changes for a task. Changes for this task only take precedence.
///
/// # Errors
/// If there is no such method.
pub(super) fn changes(methods: &Table, name: &str, task: &str) -> Result<Table, Error> {
    let mut changes = whole(methods, name)?;
    changes.remove("about");
    let mut of_tasks = taken(&mut changes, "task");
    merge(&mut changes, taken(&mut of_tasks, task));
    Ok(changes)
}

/// Returns a method's table, laid over that of the method it is `like`.
fn whole(methods: &Table, name: &str) -> Result<Table, Error> {
    let Some(Value::Table(own)) = methods.get(name) else {
        return Err(out_of_range("method", &format!("one of {}", names(methods)), name));
    };
    let mut own = own.clone();
    let Some(Value::String(like)) = own.remove("like") else { return Ok(own) };
    let mut changes = whole(methods, &like)?;
    merge(&mut changes, own);
    Ok(changes)
}
