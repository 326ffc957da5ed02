"""Goalward's own tasks as environments of Gymnasium, stepped by `goalward-actor`.

`gymnasium.make("goalward.envs:goalward/FetchPush-v0", noise=2.0)`; importing this module registers them.
Keyword arguments are keys of the task's `[environment]`.
"""

from __future__ import annotations

from goalward.packages import optional

# Ahead of the module that is made of it, so that whoever lacks it hears what installs it.
gymnasium = optional("gymnasium", "envs")

from goalward.envs.environment import Environment  # noqa: E402

__all__ = ["TASKS", "Environment"]

TASKS = {
    "goalward/Navigation-v0": "navigation",
    "goalward/FetchPick-v0": "fetch-pick",
    "goalward/FetchPush-v0": "fetch-push",
    "goalward/AntReach-v0": "ant-reach",
}


for _name, _task in TASKS.items():
    gymnasium.register(_name, entry_point="goalward.envs:Environment", kwargs={"task": _task})
