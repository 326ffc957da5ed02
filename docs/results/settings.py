"""The settings that decide a run's result, put together as `goalward train` does.

The defaults come first, then a task's file, a preset of it, what a method changes, and `key=value` settings;
the later wins. Names of method and preset are left out: two with the same settings mean the same run.
"""

from functools import cache, reduce
from pathlib import Path
from typing import Any

import tomllib

REPOSITORY = Path(__file__).resolve().parents[2]

# What decides no result: names of what the rest spells out, tables of all learners, and what changes none.
LEFT_OUT = ["method", "preset", "learners", "resources", "checkpoint", "log"]

Table = dict[str, Any]
# Keys and values.
Settings = frozenset[tuple[str, Any]]


def resolved(task: str, preset: str | None, method: str, changes: list[str]) -> Settings:
    """All settings of a run of a task."""
    file = read(f"deploy/tasks/{task.replace('-', '_')}.toml")
    presets = file.get("preset", {})
    layers = [defaults(file), without(file, "preset"), presets[preset] if preset else {}]
    layers += [of_method(method, task), *map(setting, changes)]
    whole = reduce(merged, layers, {})
    return frozenset(flat(without(whole, *LEFT_OUT)).items())


def defaults(file: Table) -> Table:
    """The defaults of all tasks, and those of tasks with such observations."""
    found = read("protocol/run/src/config/defaults.toml")
    of_kinds = [found[kind] for kind in ("cells", "vector") if kind in file["task"]["observation"]]
    return reduce(merged, of_kinds, without(found, "cells", "vector"))


def of_method(name: str, task: str) -> Table:
    """What a method changes for a task; what is for that task only wins."""
    changes = whole(name)
    return merged(without(changes, "about", "task"), changes.get("task", {}).get(task, {}))


def whole(method: str) -> Table:
    """A method's table, laid over that of the method it is like."""
    own = read("deploy/methods.toml")[method]
    return merged(whole(own["like"]), without(own, "like")) if "like" in own else own


def setting(text: str) -> Table:
    """A `key=value`; a value that is no TOML is text."""
    key, value = text.split("=", 1)
    try:
        return tomllib.loads(f"{key} = {value}")
    except tomllib.TOMLDecodeError:
        return tomllib.loads(f'{key} = "{value}"')


@cache
def read(file: str) -> Table:
    """A file of the repository."""
    return tomllib.loads((REPOSITORY / file).read_text())


def without(table: Table, *names: str) -> Table:
    """A table but for some of its entries."""
    return {name: value for name, value in table.items() if name not in names}


def merged(table: Table, changes: Table) -> Table:
    """A table with another one laid over it."""
    laid = {
        name: merged(table[name], value)
        if isinstance(value, dict) and isinstance(table.get(name), dict)
        else value
        for name, value in changes.items()
    }
    return table | laid


def flat(table: Table) -> dict[str, Any]:
    """The values of a table and of those in it, by dotted key."""
    found = {}
    for key, value in table.items():
        if isinstance(value, dict):
            found |= {f"{key}.{rest}": inner for rest, inner in flat(value).items()}
        else:
            found[key] = tuple(value) if isinstance(value, list) else value
    return found
