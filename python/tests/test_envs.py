"""Tests of Goalward's tasks as Gymnasium environments, stepped by the program itself.

They need `goalward-actor` in PATH, or its path in GOALWARD_ACTOR.
"""

from __future__ import annotations

import gc
import importlib
import os
import shutil
import signal
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import goalward
from goalward.envs import TASKS, Environment

pytestmark = pytest.mark.skipif(
    not (os.environ.get("GOALWARD_ACTOR") or shutil.which("goalward-actor")),
    reason="goalward-actor is neither in PATH nor where GOALWARD_ACTOR says",
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
    """Act in an episode with random actions, drawn with the same seed; return what was seen."""
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
        # It warns that observations have no bounds.
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
    Environment("fetch-push", noise=np.float32(1.5)).close()
    with pytest.raises(goalward.Error, match="noise"):
        Environment("fetch-push", noise=99.0)
    with pytest.raises(goalward.Error, match="fetch-push: expected a setting in JSON"):
        Environment("fetch-push", noise=float("nan"))
    with pytest.raises(goalward.Error, match="expected a setting in JSON, found a value of type set"):
        Environment("fetch-push", noise={1})
    with pytest.raises(goalward.Error, match="unknown task"):
        Environment("flying")


def test_there_is_nothing_to_render() -> None:
    gymnasium.make("goalward/Navigation-v0", render_mode=None).close()
    with pytest.raises(TypeError, match="render_mode: expected none, found rgb_array"):
        Environment("navigation", render_mode="rgb_array")


def test_an_interrupt_leaves_no_answer_for_the_next_request() -> None:
    def interrupt(*_: object) -> None:
        raise TimeoutError

    environment = Environment("ant-reach")
    environment.reset(seed=1)
    read = environment._link._read
    environment._link._read = interrupt  # type: ignore[method-assign,assignment]
    with pytest.raises(TimeoutError):
        environment.step(np.zeros(8))
    environment._link._read = read  # type: ignore[method-assign]
    with pytest.raises(goalward.Error, match="found one that was closed"):
        environment.step(np.zeros(8))


def test_a_forked_process_does_not_keep_it_open() -> None:
    environment = Environment("navigation")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the child needs no other threads
        forked = os.fork()
    if forked == 0:
        time.sleep(60)
        os._exit(0)
    begun = time.monotonic()
    environment.close()
    os.kill(forked, signal.SIGKILL)
    os.waitpid(forked, 0)
    assert time.monotonic() - begun < 30


def test_what_is_refused_changes_nothing() -> None:
    with Environment("navigation") as environment:
        with pytest.raises(goalward.Error, match="no episode is running"):
            environment.step(0)
        with pytest.raises(goalward.Error, match="expected a scripted expert and an episode"):
            environment.expert_action()
        played = play(environment, 1)
        with pytest.raises(goalward.Error, match="no episode is running"):
            environment.step(0)
        assert play(environment, 1) == played


def test_an_episode_goes_on_after_an_action_that_is_refused() -> None:
    with Environment("fetch-push") as environment:
        environment.reset(seed=1)
        with pytest.raises(goalward.Error, match="expected finite numbers .* found NaN at index 1"):
            environment.step([0.0, np.nan, 0.0])
        environment.step([0.0, 2.0, 0.0])


@pytest.mark.parametrize(
    ("task", "action", "words"),
    [
        ("navigation", -1, r"expected one of Discrete\(4\), found -1"),
        ("navigation", 4, r"expected one of Discrete\(4\), found 4"),
        ("navigation", 256, r"expected one of Discrete\(4\), found 256"),
        ("navigation", 1.5, r"expected one of Discrete\(4\), found 1.5"),
        ("navigation", [1, 2], r"expected one of Discrete\(4\), found \[1, 2\]"),
        ("fetch-push", [0.0, 0.0], r"expected shape \(3,\), found \(2,\)"),
        ("fetch-push", np.zeros((2, 3)), r"expected shape \(3,\), found \(2, 3\)"),
        ("fetch-push", 0.0, r"expected shape \(3,\), found \(\)"),
        ("fetch-push", [[0.0], [0.0, 1.0]], r"expected one of Box.*, found \[\[0.0\], \[0.0, 1.0\]\]"),
        ("fetch-push", "push", "expected one of Box.*, found 'push'"),
    ],
)
def test_an_action_that_is_none_of_the_tasks_is_refused(task: str, action: Any, words: str) -> None:
    with Environment(task) as environment:
        environment.reset(seed=1)
        with pytest.raises(goalward.Error, match=f"^action: {words}"):
            environment.step(action)
        environment.step(environment.action_space.sample())


def test_a_program_that_cannot_be_run_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "actor").write_text("no program")
    monkeypatch.setenv("GOALWARD_ACTOR", str(tmp_path / "actor"))
    with pytest.raises(goalward.Error, match="found no program .*/actor"):
        Environment("navigation")
    (tmp_path / "actor").chmod(0o755)
    with pytest.raises(goalward.Error, match="expected the program .*/actor to start, found .*Exec format"):
        Environment("navigation")


def test_gymnasium_is_asked_for_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "goalward.envs")
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(goalward.Error, match=r"pip install 'goalward\[envs\]'"):
        importlib.import_module("goalward.envs")


ENDING = '''
"""Says that it is a task of a choice, fails at the first request, and ends."""
import json, os, struct, sys

def send(kind, body):
    text = json.dumps(body).encode()
    os.write(1, struct.pack("<IB", len(text), kind) + text)

shapes = {"observation": {"vector": {"len": 1}}, "action": {"discrete": {"count": 4}}}
send(1, {**shapes, "horizon_steps": 9, "labels": [str(os.getpid())]})
os.read(0, 999)
os.close(0)
send(3, {"error": "a fall from the edge"})
sys.exit("a last word")
'''


def process_of(environment: Environment) -> int:
    return environment._link._process.pid


def test_an_environment_that_is_dropped_leaves_no_process_behind() -> None:
    environment = Environment("navigation")
    process = process_of(environment)
    del environment
    gc.collect()
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


def test_a_program_that_was_killed_is_told_of() -> None:
    with Environment("navigation") as environment:
        os.kill(process_of(environment), signal.SIGKILL)
        with pytest.raises(goalward.Error, match="goalward-actor ended: killed by signal 9"):
            environment.reset(seed=1)


def test_a_program_that_has_ended_is_told_of_and_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "ending"
    program.write_text(f"#!{sys.executable}{ENDING}")
    program.chmod(0o755)
    monkeypatch.setenv("GOALWARD_ACTOR", str(program))
    environment = Environment("navigation")
    with pytest.raises(goalward.Error, match="a fall from the edge"):
        environment.reset(seed=1)
    for _ in range(2):
        with pytest.raises(goalward.Error, match="goalward-actor ended: a last word"):
            environment.reset(seed=1)
    environment.close()
    environment.close()
    with pytest.raises(ProcessLookupError):
        os.kill(int(environment.labels[0]), 0)
    with pytest.raises(goalward.Error, match="found one that was closed"):
        environment.reset(seed=1)
