"""Tests that policies act in the spaces that they were trained in and on observations of their task only."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from walks import ROOMS

from goalward import Cells, Continuous, Discrete, Error, Task, Vector
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


@pytest.mark.parametrize("value", [3, 256, -1, 1.5, np.nan])
@pytest.mark.parametrize("rows", [(), (2,)])
def test_a_grid_has_classes_of_the_task(value: float, rows: tuple[int, ...]) -> None:
    grid = np.zeros((*rows, 4, 5), type(value))
    grid[..., -1, 2] = value
    place = [0] * len(rows) + [3, 2]
    expected = f"policy.onnx: observations{place}: expected a whole number below 3, found {value}"
    with pytest.raises(Error, match=re.escape(expected)):
        policy(ROOMS).act(grid)


@pytest.mark.parametrize("value", [3, -1, 1.5, np.nan])
def test_a_grid_of_a_space_has_its_classes(value: float) -> None:
    act = policy(ROOMS).for_space(spaces.Box(0, 2, (4, 5), np.int64), spaces.Discrete(4))
    grid = np.zeros((4, 5))
    grid[1, 2] = value
    with pytest.raises((Error, ValueError), match=f"expected classes below 3, found {float(value)}"):
        act(grid)


@pytest.mark.parametrize("kind", [bool, np.int64, np.float32, np.uint8])
def test_classes_may_be_of_any_type(kind: type) -> None:
    assert policy(ROOMS).act(np.ones((4, 5), kind)) == 2
    assert policy(ROOMS).act(np.ones((3, 4, 5), kind)).tolist() == [2, 2, 2]


@pytest.mark.parametrize(
    ("observations", "expected"),
    [
        ([["a"] * 5] * 4, "expected numbers, found values of type <U1"),
        ([[0], [0, 1]], "expected one array, found rows of differing lengths"),
        (np.zeros((5, 4)), r"expected shape (4, 5) or rows of it, found (5, 4)"),
    ],
)
def test_what_is_no_observation_is_refused(observations: Any, expected: str) -> None:
    with pytest.raises(Error, match=re.escape(f"policy.onnx: observations: {expected}")):
        policy(ROOMS).act(observations)


class Distribution:
    """Replaces onnxruntime's session: returns the same parameters of a distribution for every row."""

    def __init__(self, **parameters: list[float]) -> None:
        self.parameters = parameters

    def get_outputs(self) -> list[SimpleNamespace]:
        return [SimpleNamespace(name=name) for name in ("action", *self.parameters)]

    def run(self, _: Any, inputs: dict[str, Any]) -> list[Any]:
        rows = len(inputs["observation"])
        return [np.zeros(rows), *(np.tile(values, (rows, 1)) for values in self.parameters.values())]


@pytest.mark.parametrize("distribution", ["gaussian", "squashed-gaussian"])
def test_numbers_are_drawn_from_the_policys_distribution(distribution: str) -> None:
    arm = policy(Task("arm", Vector(3), Continuous(2), 9))
    mean, log_deviation, scale = [0.2, -0.1], [-1.0, -3.0], [0.5, 2.0]
    arm._session = Distribution(mean=mean, log_standard_deviation=log_deviation)
    arm.config = {"policy": {"distribution": distribution}, "environment": {"action_scale": scale}}
    actions = arm.act(np.zeros((20_000, 3)), np.random.default_rng(7))
    drawn = np.random.default_rng(7).normal(mean, np.exp(log_deviation), actions.shape)
    expected = np.tanh(drawn) if distribution == "squashed-gaussian" else drawn
    np.testing.assert_allclose(actions, np.clip(expected * scale, -1, 1), atol=1e-6)


def test_choices_are_drawn_as_often_as_the_logits_say() -> None:
    task = policy(Task("own", Vector(2), Discrete(3), 9))
    task._session = Distribution(logits=list(np.log([0.6, 0.3, 0.1])))
    choices = task.act(np.zeros((20_000, 2)), np.random.default_rng(7))
    np.testing.assert_allclose(np.bincount(choices, minlength=3) / 20_000, [0.6, 0.3, 0.1], atol=0.02)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e39])
def test_numbers_are_finite(value: float) -> None:
    task = policy(Task("own", Vector(2), Discrete(3), 9))
    expected = f"policy.onnx: observations[1, 0]: expected a finite float32, found {value}"
    with pytest.raises(Error, match=re.escape(expected)):
        task.act(np.array([[0.0, 0.0], [value, 0.0]]))


def test_spaces_that_no_task_has_are_refused() -> None:
    task = policy(Task("own", Vector(2), Discrete(3), 9))
    unbounded = spaces.Box(-np.inf, np.inf, (2,))
    with pytest.raises(Error, match="policy.onnx: expected spaces of a task, found "):
        task.for_space(unbounded, unbounded)
