"""`Trajectory`: one recorded episode as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from goalward.error import Error
from goalward.task import Cells, Discrete, Task

Ending = Literal["goal_reached", "truncated", "failed"]
ENDINGS: tuple[Ending, ...] = ("goal_reached", "truncated", "failed")
"""The endings, indexed by their numbers in the schema."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One episode of T steps.

    Attributes:
        observations: (T + 1, len) float32 numbers, or (T + 1, height, width) uint8 cell classes.
        actions: (T, len) float32 numbers as the policy chose them, before the environment scaled and clipped
            them (see `Log.acted`), or (T,) uint8 choices.
        rewards: (T,) float32 rewards of the environment.
        log_probs: (T,) float32 log-probabilities of the actions under the acting policy.
        ending: `goal_reached` if the task ended the episode at the goal, `truncated` if the horizon ended it,
            `failed` if the task ended it elsewhere.
        success: whether the goal was reached at any step.
        steps_to_goal: number of steps after which the goal was first reached; 0 if it was not.
        iteration: the iteration that the episode belongs to.
        lane: the lane that the episode belongs to.
        episode: its number within the lane.
        policy_version: number of updates of the acting policy.
    """

    observations: NDArray[Any]
    actions: NDArray[Any]
    rewards: NDArray[np.float32]
    log_probs: NDArray[np.float32]
    ending: Ending
    success: bool
    steps_to_goal: int
    iteration: int
    lane: int
    episode: int
    policy_version: int

    @property
    def steps(self) -> int:
        """The number of steps, T."""
        return len(self.rewards)


def decoded(message: Any, task: Task) -> Trajectory:
    """Make a trajectory from its message.

    Args:
        message: a `goalward.v1.Trajectory`.
        task: the task of the run.

    Raises:
        Error: if the log has no observations, or an array does not have the length that the task implies.
    """
    if message.full_hash:
        expected = f"{place(message)}: expected observations, found that they were left out of the log"
        raise Error(f"{expected}; `goalward log restore RUN --out DIR` restores them")
    steps = (message.steps,)
    field = "cells" if isinstance(task.observation, Cells) else "values"
    return Trajectory(
        observations=_array(message, field, (message.steps + 1, *task.observation.shape)),
        actions=actions(message, task),
        rewards=_array(message, "environment_rewards", steps),
        log_probs=_array(message, "log_probs", steps),
        ending=ending(message),
        success=message.success,
        steps_to_goal=message.steps_to_goal,
        iteration=message.iteration,
        lane=message.lane,
        episode=message.episode,
        policy_version=message.policy_version,
    )


def ending(message: Any) -> Ending:
    """Return how the episode of a trajectory's message ended.

    Raises:
        Error: if the number of its ending is unknown.
    """
    number = int(message.ending)
    if not 0 <= number < len(ENDINGS):
        raise Error(f"{place(message)}: ending: expected one of {', '.join(ENDINGS)}, found {number}")
    return ENDINGS[number]


def actions(message: Any, task: Task) -> NDArray[Any]:
    """Return the actions of a trajectory's message: (T,) uint8 choices, or (T, len) float32 numbers.

    Raises:
        Error: if their number does not match the task.
    """
    if isinstance(task.action, Discrete):
        return _array(message, "discrete_actions", (message.steps,))
    return _array(message, "continuous_actions", (message.steps, task.action.len))


def _array(message: Any, field: str, shape: tuple[int, ...]) -> NDArray[Any]:
    value = getattr(message, field)
    flat = np.frombuffer(value, np.uint8).copy() if isinstance(value, bytes) else np.array(value, np.float32)
    if flat.size != np.prod(shape):
        raise Error(f"{place(message)}: {field}: expected shape {shape}, found {flat.size} values")
    return flat.reshape(shape)


def place(message: Any) -> str:
    """Return the episode that a message is about, for error messages."""
    return f"iteration {message.iteration}, lane {message.lane}, episode {message.episode}"
