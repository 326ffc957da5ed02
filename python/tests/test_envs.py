"""Goalward's tasks as environments of Gymnasium, stepped by the program itself.

They need `goalward-actor` in PATH or where GOALWARD_ACTOR says.
"""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import goalward
from goalward.envs import TASKS, Environment

pytestmark = pytest.mark.skipif(
    not (os.environ.get("GOALWARD_ACTOR") or shutil.which("goalward-actor")),
    reason="goalward-actor is not there",
)


@pytest.fixture(params=TASKS)
def environment(request: pytest.FixtureRequest) -> Iterator[gymnasium.Env[Any, Any]]:
    made: gymnasium.Env[Any, Any] = gymnasium.make(request.param)
    yield made
    made.close()


def own(environment: gymnasium.Env[Any, Any]) -> Environment:
    found = environment.unwrapped
    assert isinstance(found, Environment)
    return found


def play(environment: gymnasium.Env[Any, Any], seed: int) -> list[bytes]:
    """Act with a random policy of its own seed for an episode."""
    observation, _ = environment.reset(seed=seed)
    rng, seen, ended = np.random.default_rng(seed), [observation.tobytes()], False
    space = environment.action_space
    while not ended:
        action: Any = rng.integers(space.n) if isinstance(space, gymnasium.spaces.Discrete) else None
        if action is None:
            action = rng.uniform(-1, 1, space.shape or ())
        observation, reward, terminated, truncated, _ = environment.step(action)
        seen.append(observation.tobytes() + np.float32(reward).tobytes())
        ended = terminated or truncated
    return seen


def test_gymnasium_finds_nothing_wrong(environment: gymnasium.Env[Any, Any]) -> None:
    with warnings.catch_warnings():
        # Observations have no bounds, which it remarks on.
        warnings.simplefilter("ignore", UserWarning)
        check_env(own(environment), skip_render_check=True)


def test_an_episode_is_a_function_of_its_seed(environment: gymnasium.Env[Any, Any]) -> None:
    first, other = play(environment, 1), play(environment, 2)
    assert first != other
    assert play(environment, 1) == first
    assert len(first) <= own(environment).horizon_steps + 1


@pytest.mark.parametrize("task", [name for name in TASKS if "Ant" not in name])
def test_the_scripted_expert_reaches_the_goal(task: str) -> None:
    environment: gymnasium.Env[Any, Any] = gymnasium.make(task)
    successes = 0
    for seed in range(10):
        environment.reset(seed=seed)
        ended, info = False, {"is_success": False}
        while not ended:
            _, _, terminated, truncated, info = environment.step(own(environment).expert_action())
            ended = terminated or truncated
        successes += info["is_success"]
    environment.close()
    assert successes == 10


def test_keywords_are_the_environments_setting() -> None:
    with pytest.raises(goalward.Error, match="noise"):
        Environment("fetch-push", noise=99.0)
    with pytest.raises(goalward.Error, match="unknown task"):
        Environment("flying")


def test_steps_out_of_turn_are_refused_in_words() -> None:
    environment = Environment("navigation")
    with pytest.raises(goalward.Error, match="no episode is running"):
        environment.step(0)
    environment.close()
