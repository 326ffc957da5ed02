"""Environments for tests: a sound one, and one for every way to fail."""

import ctypes
import os
import sys
import time
from importlib import metadata
from typing import ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces


class Line(gymnasium.Env):
    """A point that moves along a line: it succeeds beyond 1 and fails beyond -1."""

    observation_space = spaces.Dict(
        {"place": spaces.Box(-9.0, 9.0, (1,)), "parity": spaces.Discrete(2), "said": spaces.Text(9)}
    )
    action_space = spaces.Box(np.array([0.0]), np.array([0.5]))
    metadata: ClassVar = {"render_modes": ["rgb_array"]}

    def __init__(self, start=0.0, render_mode=None):
        self.start, self.render_mode = start, render_mode

    def render(self):
        picture = np.zeros((20, 900, 3), dtype=np.uint8)
        picture[:, : int(100 * (2.0 + self.place))] = 255
        return picture

    def seen(self):
        return {"place": np.array([self.place], dtype=np.float32), "parity": self.steps % 2, "said": "so"}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.steps = self.start + self.np_random.uniform(-0.1, 0.1), 0
        return self.seen(), {}

    def step(self, action):
        self.place += float(action[0]) - 0.15
        self.steps += 1
        print("a word that is no frame", flush=True)
        success = self.place > 1
        return self.seen(), -1.0, success or self.place < -1, self.steps >= 20, {"is_success": success}


class Particular(Line):
    """Has no pictures and no limit, tells success only at the end, and writes a file when it is closed."""

    metadata: ClassVar = {"render_modes": []}
    max_steps = float("inf")

    def __init__(self, leaves=os.devnull, render_mode=None):
        assert render_mode is None
        super().__init__()
        self.leaves = leaves

    def render(self):
        return None

    def step(self, action):
        *taken, info = super().step(action)
        return *taken, info if taken[2] else {}

    def close(self):
        with open(self.leaves, "w") as file:
            file.write("closed")


def line(start=0.0, render_mode=None):
    return gymnasium.wrappers.TimeLimit(Line(start, render_mode), 20)


def is_far(seen, reward, terminated, info):
    return bool(seen["place"][0] > 1)


def expert(environment):
    """Returns an expert that always takes the largest action."""
    return lambda seen: environment.action_space.high


def lost_expert(environment):
    """Returns an expert whose actions have the shape of another environment."""
    return lambda seen: [seen["place"][0], 2.0]


class Grid(gymnasium.Env):
    """A grid of three classes, with actions of two choices."""

    observation_space = spaces.Box(0, 2, (3, 4), dtype=np.int64)
    action_space = spaces.MultiDiscrete([2, 3])

    def reset(self, *, seed=None, options=None):
        return np.zeros((3, 4), dtype=np.int64), {}

    def step(self, action):
        return np.full((3, 4), 2), 10 * action[0] + action[1], False, False, {}


class Bad(Line):
    """Fails in the way that `how` names, for most of them at the third step."""

    def __init__(self, how):
        super().__init__()
        self.how, self.total = how, 0

    def reset(self, *, seed=None, options=None):
        if self.how == "reset raises":
            raise RuntimeError("no start today")
        return super().reset(seed=seed)

    def step(self, action):
        seen, reward, terminated, truncated, info = super().step(action)
        self.total += 1
        if self.how == "raises late" and self.total > 200:
            raise ZeroDivisionError("by nothing")
        if self.steps < 3:
            return seen, reward, terminated, truncated, info
        if self.how in ("raises", "raises beside"):
            raise ZeroDivisionError("by nothing")
        if self.how == "no number":
            seen["place"][0] = np.nan
        if self.how == "wrong shape":
            seen["place"] = np.zeros(2, dtype=np.float32)
        if self.how == "nothing":
            return None
        if self.how == "four values":
            return seen, reward, terminated, info
        if self.how == "endless reward":
            reward = float("inf")
        if self.how == "odd success":
            info["is_success"] = "maybe"
        if self.how == "memory":
            raise MemoryError
        if self.how == "exits":
            os._exit(7)
        if self.how == "crashes":
            ctypes.string_at(0)
        if self.how == "hangs":
            time.sleep(1000)
        return seen, reward, terminated, truncated, info


def bad(how):
    return gymnasium.wrappers.TimeLimit(Bad(how), 20)


class Traced(Line):
    """Starts at a place that depends on where the previous episode ended."""

    def reset(self, *, seed=None, options=None):
        before = getattr(self, "place", 0.0)
        super().reset(seed=seed)
        self.place += before / 10
        return self.seen(), {}


def traced():
    return gymnasium.wrappers.TimeLimit(Traced(), 20)


class Chance(Line):
    """Has a random source of its own, which no seed controls."""

    def step(self, action):
        self.place += os.urandom(1)[0] / 1000
        return super().step(action)


def chance():
    return gymnasium.wrappers.TimeLimit(Chance(), 20)


class SharedChance(Line):
    """Draws from the random generator that all environments of a process share."""

    def step(self, action):
        self.place += np.random.uniform(-0.1, 0.1)
        return super().step(action)


def shared_chance():
    return gymnasium.wrappers.TimeLimit(SharedChance(), 20)


class Unordered(Line):
    """Depends on the order of strings in a set, which follows from their hashes."""

    def step(self, action):
        places = {f"place {number}" for number in range(100)}
        self.place += list(places).index("place 0") / 1000
        return super().step(action)


def unordered():
    return gymnasium.wrappers.TimeLimit(Unordered(), 20)


def conflicting():
    """Fails like an environment of gymnasium-robotics with a version of mujoco that is too new for it."""
    found = {"gymnasium-robotics": "1.4.2", "mujoco": "4.0.0"}
    installed = metadata.version
    metadata.version = lambda package: found.get(package) or installed(package)
    sys.modules["gymnasium_robotics"] = sys.modules[__name__]
    return gymnasium.wrappers.TimeLimit(Bad("reset raises"), 20)


class Picture(Line):
    observation_space = spaces.Box(0, 255, (96, 96, 3), dtype=np.uint8)


class Unbounded(Line):
    action_space = spaces.Box(-np.inf, np.inf, (1,))


class ManyChoices(Line):
    action_space = spaces.MultiDiscrete([17, 17])


def no_environment():
    return "a text"
