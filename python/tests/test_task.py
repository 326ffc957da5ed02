"""Tests of tasks: they are read from TOML and JSON, and refused if Goalward would refuse them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goalward import Cells, Continuous, Discrete, Error, Task, Vector

TABLE: dict[str, Any] = {
    "name": "reach",
    "observation": {"vector": {"len": 2}},
    "action": {"continuous": {"len": 1}},
    "horizon_steps": 9,
}


def test_a_task_is_read_from_the_table_of_its_file(tmp_path: Path) -> None:
    file = tmp_path / "maze.toml"
    file.write_text(
        'steps = 5\n[task]\nname = "maze"\nhorizon_steps = 7\nlabels = ["x[0]", "x[1]"]\n'
        "tells_success = false\n[task.observation.vector]\nlen = 2\n[task.action.discrete]\ncount = 4\n"
    )
    expected = Task("maze", Vector(2), Discrete(4), 7, labels=("x[0]", "x[1]"), tells_success=False)
    assert Task.from_toml(file) == expected


@pytest.mark.parametrize(
    "task",
    [
        Task("a", Cells(3, 4, 5), Discrete(2), 1),
        Task("b", Vector(1), Continuous(3), 1_000_000, labels=("x",), deterministic=False),
        Task("c", Vector(1), Continuous(3), 2, tells_success=False, program="act", program_sha256="00"),
    ],
)
def test_json_gives_the_same_task_again(task: Task) -> None:
    assert Task.from_json(task.to_json()) == task


def test_json_names_shapes_as_goalward_does() -> None:
    table = json.loads(Task("a", Cells(3, 4, 5), Continuous(2), 9).to_json())
    assert table["observation"] == {"cells": {"height": 3, "width": 4, "classes": 5}}
    assert table["action"] == {"continuous": {"len": 2}}
    assert "labels" not in table
    assert "program" not in table


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            {"name": "a b"},
            "task.name: expected up to 64 letters, digits, `-`, `_` and `.`, the first not `.`, found a b",
        ),
        ({"horizon_steps": 0}, "task.horizon_steps: expected a number from 1 to 1000000, found 0"),
        ({"horizon_steps": True}, "task.horizon_steps: expected a number from 1 to 1000000, found True"),
        ({"labels": ["x"]}, "task.labels: expected none, or 2, one for each class or number, found 1"),
        ({"action": {"discrete": {"count": 257}}}, "task.action: expected a number from 1 to 256, found 257"),
        ({"action": {"discrete": {"len": 2}}}, "task.action.discrete: expected count, found ['len']"),
        ({"observation": {"image": {}}}, "task.observation: expected vector or cells, found image"),
        ({"observation": [1]}, "task.observation: expected vector or cells, found [1]"),
        ({"labels": "xy"}, "task.labels: expected a list of texts, found xy"),
        ({"tells_success": "no"}, "task.tells_success: expected true or false, found no"),
        ({"colour": 1}, "found an unknown key"),
    ],
)
def test_a_value_out_of_range_is_refused_by_its_key(change: dict[str, Any], expected: str) -> None:
    with pytest.raises(Error) as refusal:
        Task.from_table({**TABLE, **change})
    assert expected in str(refusal.value)


def test_a_missing_key_is_named() -> None:
    with pytest.raises(Error, match="task.action: expected a value, found none"):
        Task.from_table({key: value for key, value in TABLE.items() if key != "action"})


@pytest.mark.parametrize(
    ("text", "expected"),
    [("[task", "expected the file of a task"), ("steps = 1", r"expected a table \[task\], found steps")],
)
def test_a_file_without_a_task_is_refused_in_one_line(tmp_path: Path, text: str, expected: str) -> None:
    file = tmp_path / "task.toml"
    file.write_text(text)
    with pytest.raises(Error, match=expected) as refusal:
        Task.from_toml(file)
    assert "\n" not in str(refusal.value)


def test_numbers_may_be_numpys_and_labels_a_list() -> None:
    length: Any = np.prod((2, 1))
    count: Any = np.int64(2)
    labels: Any = ["x", "y"]
    task = Task("a", Vector(length), Discrete(count), 5, labels=labels)
    assert task == Task("a", Vector(2), Discrete(2), 5, labels=("x", "y"))
    assert Task.from_json(task.to_json()) == task
