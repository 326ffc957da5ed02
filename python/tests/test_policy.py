"""Tests that policies act in the spaces that they were trained in, and in no others."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from goalward import Cells, Discrete, Error, Task, Vector
from goalward.policy import Policy


class Session:
    """Replaces onnxruntime's session: returns choice 2 for every row."""

    def get_outputs(self) -> list[SimpleNamespace]:
        return [SimpleNamespace(name="action")]

    def run(self, _: Any, inputs: dict[str, Any]) -> list[Any]:
        return [np.full(len(inputs["observation"]), 2, dtype=np.int64)]


def policy(task: Task) -> Policy:
    made = object.__new__(Policy)
    made.path, made.task, made._session = Path("policy.onnx"), task, Session()
    return made


def test_a_grid_is_known_by_its_shape_whatever_its_classes_are_called() -> None:
    labels = ("empty", "wall", "goal", "agent")
    task = Task("navigation", Cells(19, 19, 4), Discrete(4), 100, labels=labels)
    grid = spaces.Box(0, 3, (19, 19), np.uint8)
    act = policy(task).for_space(grid, spaces.Discrete(4))
    assert act(np.zeros((19, 19), dtype=np.uint8)) == 2
    with pytest.raises(Error, match="expected the spaces"):
        policy(task).for_space(spaces.Box(0, 4, (19, 19), np.uint8), spaces.Discrete(4))


def test_numbers_are_known_by_their_labels_where_the_task_has_some() -> None:
    task = Task("own", Vector(2), Discrete(4), 9, labels=("x", "y"))
    numbers, choices = spaces.Box(-1.0, 1.0, (2,)), spaces.Discrete(4)
    with pytest.raises(Error, match="expected the spaces .*'x', 'y'.* found .*observation"):
        policy(task).for_space(numbers, choices)
    act = policy(replace(task, labels=())).for_space(numbers, choices)
    assert act(np.zeros(2, dtype=np.float32)) == 2
