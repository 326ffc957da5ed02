"""A task of Goalward as a Gymnasium environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from goalward import spaces
from goalward.envs.link import SUCCESS, TERMINATED, TRUNCATED, Link
from goalward.error import Error, one_line


class Environment(gymnasium.Env[NDArray[Any], Any]):
    """A task that `goalward-actor` acts in. An episode is a pure function of its seed and its actions.

    Observations are `(len,)` float32, or `(height, width)` uint8 with a class for each cell. An action is a
    choice, or `(len,)` float32 in [-1, 1]. `info["is_success"]` says whether the goal has been reached.

    Attributes:
        labels: names of the numbers of an observation; empty if they have none.
        horizon_steps: the longest episode in steps; it is truncated there.
    """

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self, task: str, render_mode: str | None = None, **setting: Any) -> None:
        """Start `goalward-actor`.

        Args:
            task: `navigation`, `fetch-pick`, `fetch-push` or `ant-reach`.
            render_mode: must be None, because the environment cannot render.
            setting: keys of the task's table `[environment]`, such as `noise`.

        Raises:
            TypeError: for any render mode, which tells Stable-Baselines3 to try without one.
            Error: if the program is missing, or does not know the task or a setting.
        """
        if render_mode is not None:
            raise TypeError(f"render_mode: expected none, found {one_line(render_mode)}")
        self._link = Link(task, setting)
        hello = self._link.hello
        self.labels: list[str] = hello["labels"]
        self.horizon_steps: int = hello["horizon_steps"]
        self.observation_space = _observation_space(hello["observation"])
        self.action_space = _action_space(hello["action"])
        self._actions = spaces.actions_of(self.action_space)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode; the same seed begins the same one."""
        super().reset(seed=seed)
        _, _, observation = self._link.reset(int(self.np_random.integers(2**31)))
        return self._observed(observation), {"is_success": False}

    def step(self, action: Any) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Take an action.

        Raises:
            Error: if no episode is running, or the action is not valid; nothing has changed then.
        """
        reward, flags, observation = self._link.step(self._bytes(action))
        ended = bool(flags & TERMINATED), bool(flags & TRUNCATED)
        return self._observed(observation), reward, *ended, {"is_success": bool(flags & SUCCESS)}

    def expert_action(self) -> Any:
        """Return the scripted expert's action in the current state; `step` clips it to its bounds.

        Raises:
            Error: if there is no such expert, no episode is running, or the expert of NAVIGATION has reached
                the goal and has no action left.
        """
        taken = self._link.expert_action()
        if isinstance(self.action_space, gymnasium.spaces.Discrete):
            return int(taken[0])
        return np.frombuffer(taken, dtype="<f4").copy()

    def close(self) -> None:
        """End `goalward-actor`."""
        self._link.close()

    def _observed(self, data: bytes) -> NDArray[Any]:
        space = self.observation_space
        return np.frombuffer(data, dtype=space.dtype).reshape(space.shape or ()).copy()

    def _bytes(self, action: Any) -> bytes:
        try:
            data: bytes = self._actions.encode(action)
        except ValueError as refusal:
            raise Error(one_line(refusal)) from refusal
        return data


def _observation_space(observation: dict[str, dict[str, int]]) -> gymnasium.spaces.Box:
    if "vector" in observation:
        return gymnasium.spaces.Box(-np.inf, np.inf, (observation["vector"]["len"],), dtype=np.float32)
    cells = observation["cells"]
    shape = (cells["height"], cells["width"])
    return gymnasium.spaces.Box(0, cells["classes"] - 1, shape, dtype=np.uint8)


def _action_space(action: dict[str, dict[str, int]]) -> gymnasium.spaces.Space[Any]:
    if "discrete" in action:
        return gymnasium.spaces.Discrete(action["discrete"]["count"])
    return gymnasium.spaces.Box(-1.0, 1.0, (action["continuous"]["len"],), dtype=np.float32)
