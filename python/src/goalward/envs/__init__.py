"""Goalward's own tasks as Gymnasium environments, stepped by `goalward-actor`.

Importing this module registers them, as in
`gymnasium.make("goalward.envs:goalward/FetchPush-v0", noise=2.0)`. Keyword arguments are keys of the task's
table `[environment]`.
"""

from __future__ import annotations

from goalward.packages import optional

# Before the module that imports it, so that the error for a missing package says how to install it.
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
