"""Goalward's own tasks as environments of Gymnasium, stepped by `goalward-actor`.

`gymnasium.make("goalward.envs:goalward/FetchPush-v0", noise=2.0)`; importing this module registers them.
Keyword arguments are keys of the task's `[environment]`.
"""

from __future__ import annotations

from typing import Any

from goalward.envs.environment import Environment
from goalward.packages import optional

__all__ = ["TASKS", "Environment"]

TASKS = {
    "goalward/Navigation-v0": "navigation",
    "goalward/FetchPick-v0": "fetch-pick",
    "goalward/FetchPush-v0": "fetch-push",
    "goalward/AntReach-v0": "ant-reach",
}


def _register() -> None:
    registration: Any = optional("gymnasium", "envs").register
    for name, task in TASKS.items():
        registration(name, entry_point="goalward.envs:Environment", kwargs={"task": task})


_register()
