//! What a method changes in the configuration of a task.

use protocol::Error;
use protocol::error::out_of_range;
use protocol::table::merge;
use toml::{Table, Value};

use super::{names, taken};

/// What the method called `name` changes for a task; what is for that task only wins.
///
/// # Errors
/// When there is no such method.
pub(super) fn changes(methods: &Table, name: &str, task: &str) -> Result<Table, Error> {
    let mut changes = whole(methods, name)?;
    changes.remove("about");
    let mut of_tasks = taken(&mut changes, "task");
    merge(&mut changes, taken(&mut of_tasks, task));
    Ok(changes)
}

/// A method's table, laid over that of the method it is `like`.
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
