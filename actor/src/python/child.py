"""Holds the environments of a Goalward actor, which talks to it over descriptor 0.

A frame is a little-endian length, a kind and a body; `actor/src/python/frame.rs` has the other half.
Nothing is installed for this file: the actor hands its text to the interpreter.
"""

import ctypes
import importlib
import json
import os
import random
import signal
import socket
import struct
import sys
import traceback
from importlib import metadata

HELLO, TURN, FAILED = 1, 2, 3
RESET, REBUILD, STEP = 0, 1, 2
TERMINATED, TRUNCATED, SUCCESS = 1, 2, 4

MOST_NUMBERS = 4096  # of one observation; an image would fill the log
MOST_CHOICES = 256  # of a discrete action, which is one byte
PACKAGES = ("gymnasium", "numpy", "gymnasium-robotics", "mujoco", "minigrid", "box2d-py", "box2d", "pygame")


class Refused(Exception):
    """What the environment has that a task cannot have."""


def take_link():
    """The socket on descriptor 0. Whatever the environment prints goes to standard error."""
    link = socket.socket(fileno=os.dup(0))
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, 0)
    os.dup2(2, 1)
    os.close(null)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = os.getppid()
    try:
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    except (AttributeError, OSError):
        pass
    if os.getppid() != parent:
        os._exit(0)
    return link


def receive(link, count):
    """Exactly so many bytes; none at the end of the link."""
    data = bytearray(count)
    view, done = memoryview(data), 0
    while done < count:
        taken = link.recv_into(view[done:])
        if taken == 0:
            return None
        done += taken
    return data


def send(link, kind, body):
    link.sendall(struct.pack("<IB", len(body), kind) + body)


def imported(reference):
    """What `module:name` names."""
    module, _, name = reference.partition(":")
    found = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    return found


def maker(reference, kwargs):
    """What makes the environment that `gym:ID`, `gym:module:ID` or `python:module:function` names."""
    import gymnasium

    kind, _, name = reference.partition(":")
    if kind == "gym":
        return lambda: gymnasium.make(name, **kwargs)
    if kind == "python":
        function = imported(name)
        return lambda: function(**kwargs)
    raise Refused(f"expected gym:ID or python:module:function, found {reference}")


def is_text(space):
    """Whether a space that is none of Gymnasium's own gives texts."""
    try:
        return isinstance(space.sample(), str)
    except Exception:
        return False


class Numbers:
    """How an observation becomes numbers: its parts one after another."""

    def __init__(self, np, spaces, space):
        self.np, self.spaces = np, spaces
        self.labels, self.dropped, self.parts = [], [], []
        self.add(space, "", lambda observation: observation)
        if len(self.labels) > MOST_NUMBERS:
            raise Refused(
                f"expected at most {MOST_NUMBERS} numbers in an observation, found {len(self.labels)}: "
                "images are not supported; wrap the environment so that it gives a vector"
            )
        if not self.labels:
            raise Refused(f"expected an observation of numbers, found {space}")

    def add(self, space, path, of):
        np, spaces = self.np, self.spaces
        name = path or "observation"
        if isinstance(space, spaces.Dict):
            for key, inner in space.spaces.items():
                self.add(inner, f"{path}/{key}" if path else str(key), lambda seen, of=of, key=key: of(seen)[key])
        elif isinstance(space, spaces.Tuple):
            for index, inner in enumerate(space.spaces):
                self.add(inner, f"{path}/{index}" if path else str(index), lambda seen, of=of, index=index: of(seen)[index])
        elif isinstance(space, (spaces.Box, spaces.MultiBinary)):
            shape = tuple(space.shape)
            count = int(np.prod(shape, dtype=np.int64))
            self.label(name, count)

            def write(seen, out, of=of, shape=shape, name=name):
                value = np.asarray(of(seen))
                if value.shape != shape:
                    raise ValueError(f"{name}: expected shape {shape}, found {value.shape}")
                out[:] = value.reshape(-1)

            self.parts.append((count, write))
        elif isinstance(space, spaces.Discrete):
            self.one_hot(name, int(space.n), int(space.start), of)
        elif isinstance(space, spaces.MultiDiscrete):
            sizes = space.nvec.reshape(-1)
            starts = np.asarray(getattr(space, "start", 0 * sizes)).reshape(-1)
            for index, (size, start) in enumerate(zip(sizes, starts)):
                element = lambda seen, of=of, index=index: np.asarray(of(seen)).reshape(-1)[index]
                self.one_hot(f"{name}/{index}", int(size), int(start), element)
        elif isinstance(space, spaces.Text) or is_text(space):
            self.dropped.append(name)
        else:
            raise Refused(f"{name}: expected a space of numbers, found {space}")

    def label(self, name, count):
        if len(self.labels) + count > 16 * MOST_NUMBERS:
            raise Refused(
                f"{name}: expected at most {MOST_NUMBERS} numbers in an observation, found {count}: images "
                "are not supported; wrap the environment so that it gives a vector"
            )
        self.labels += [name] if count == 1 else [f"{name}[{index}]" for index in range(count)]

    def one_hot(self, name, count, start, of):
        self.label(name, count)

        def write(seen, out):
            choice = int(of(seen)) - start
            if not 0 <= choice < count:
                raise ValueError(f"{name}: expected {start} to {start + count - 1}, found {choice + start}")
            out[:] = 0.0
            out[choice] = 1.0

        self.parts.append((count, write))

    def layout(self):
        return {"vector": {"len": len(self.labels)}}, self.labels

    def row(self):
        return self.np.empty(len(self.labels), dtype="<f4")

    def write(self, seen, out):
        at = 0
        for count, write in self.parts:
            write(seen, out[at : at + count])
            at += count


class Cells:
    """How an observation becomes a grid of cell classes."""

    def __init__(self, np, space):
        self.np, self.shape = np, tuple(space.shape)
        self.classes = int(space.high.reshape(-1)[0]) + 1

    @staticmethod
    def fits(np, spaces, space):
        """Whether a space is a grid of classes: two dimensions of integers from 0 up to the same number."""
        if not isinstance(space, spaces.Box) or len(space.shape) != 2 or min(space.shape) < 3:
            return False
        if not np.issubdtype(space.dtype, np.integer) or (space.low != 0).any():
            return False
        high = space.high.reshape(-1)
        return bool((high == high[0]).all()) and 1 <= int(high[0]) < 255

    def layout(self):
        height, width = self.shape
        return {"cells": {"height": height, "width": width, "classes": self.classes}}, []

    def row(self):
        return self.np.empty(self.shape[0] * self.shape[1], dtype=self.np.uint8)

    def write(self, seen, out):
        value = self.np.asarray(seen)
        if value.shape != self.shape:
            raise ValueError(f"observation: expected shape {self.shape}, found {value.shape}")
        if (value < 0).any() or (value >= self.classes).any():
            raise ValueError(f"observation: expected classes below {self.classes}, found {value.min()} to {value.max()}")
        out[:] = value.reshape(-1)


class Actions:
    """How the bytes of actions become what the environment takes."""

    def __init__(self, np, spaces, space):
        self.np = np
        if isinstance(space, spaces.Box):
            low, high = space.low.astype(np.float64), space.high.astype(np.float64)
            if not (np.isfinite(low).all() and np.isfinite(high).all()):
                raise Refused(f"expected bounded actions, found {space}; wrap it in gymnasium.wrappers.RescaleAction")
            count = int(np.prod(space.shape, dtype=np.int64))
            self.spec, self.bytes = {"continuous": {"len": count}}, 4 * count
            half, middle = ((high - low) / 2).reshape(-1), ((high + low) / 2).reshape(-1)

            def convert(raw):
                numbers = np.clip(raw.view("<f4").astype(np.float64), -1.0, 1.0) * half + middle
                numbers = numbers.astype(space.dtype).reshape(-1, *space.shape)
                return np.clip(numbers, space.low, space.high)

            self.convert = convert
            return
        if isinstance(space, spaces.Discrete):
            sizes, start = [int(space.n)], int(space.start)
            self.convert = lambda raw: [start + int(choice) for choice in raw[:, 0]]
        elif isinstance(space, (spaces.MultiDiscrete, spaces.MultiBinary)):
            binary = isinstance(space, spaces.MultiBinary)
            count = int(np.prod(space.shape, dtype=np.int64))
            sizes = [2] * count if binary else [int(size) for size in space.nvec.reshape(-1)]

            def convert(raw):
                converted = []
                for choice in raw[:, 0]:
                    digits, rest = [], int(choice)
                    for size in reversed(sizes):
                        rest, digit = divmod(rest, size)
                        digits.append(digit)
                    converted.append(np.array(digits[::-1], dtype=space.dtype).reshape(space.shape))
                return converted

            self.convert = convert
        else:
            raise Refused(f"expected actions that are numbers or choices, found {space}")
        choices = int(np.prod(sizes, dtype=object))
        if choices > MOST_CHOICES:
            raise Refused(f"expected at most {MOST_CHOICES} choices of an action, found {choices}")
        self.spec, self.bytes = {"discrete": {"count": choices}}, 1


def teller(rule):
    """What tells success of (observation, reward, terminated, info); none where nothing does."""
    if rule == "none":
        return None
    if rule in ("is_success", "success"):
        return lambda seen, reward, terminated, info: info[rule]
    if rule == "reward":
        return lambda seen, reward, terminated, info: terminated and reward > 0
    return imported(rule)


class Environments:
    """Environments by slot, made when a slot is first used."""

    def __init__(self, options):
        import gymnasium
        import numpy as np

        self.np, self.make = np, maker(options["environment"], options["kwargs"])
        self.slots = {}
        first = self.make()
        if not isinstance(first, gymnasium.Env):
            raise Refused(f"expected a gymnasium.Env, found {type(first).__name__}")
        spaces, space = gymnasium.spaces, first.observation_space
        grid = Cells.fits(np, spaces, space)
        self.observations = Cells(np, space) if grid else Numbers(np, spaces, space)
        self.actions = Actions(np, spaces, first.action_space)
        self.success, self.tells = self.find_success(options["success"])
        limit = time_limit(first)
        observation, labels = self.observations.layout()
        self.hello = {
            "observation": observation,
            "action": self.actions.spec,
            "horizon_steps": int(limit) if limit else None,
            "labels": labels,
            "dropped": getattr(self.observations, "dropped", []),
            "success": self.success,
            "versions": versions(),
        }
        self.spare = first

    def find_success(self, rule):
        """Which rule tells success, and what it is; by default what one step of chance says of it."""
        if rule == "auto":
            environment = self.make()  # one that has been acted in might not begin like a new one
            environment.reset(seed=0)
            environment.action_space.seed(0)
            info = environment.step(environment.action_space.sample())[4]
            rule = next((key for key in ("is_success", "success") if key in info), "none")
            module = type(environment.unwrapped).__module__.partition(".")[0]
            if rule == "none" and module == "minigrid":
                rule = "reward"
            environment.close()
        return rule, teller(rule)

    def fresh(self):
        made, self.spare = self.spare or self.make(), None
        return made

    def reset(self, slot, seed, rebuild):
        if rebuild and slot in self.slots:
            self.slots.pop(slot).close()
        if slot not in self.slots:
            self.slots[slot] = self.fresh()
        random.seed(seed)
        self.np.random.seed(seed)
        observation, _ = self.slots[slot].reset(seed=seed)
        out = self.observations.row()
        self.observations.write(observation, out)
        return struct.pack("<HBBf", slot, 0, 0, 0.0) + out.tobytes()

    def step(self, slot, action):
        result = self.slots[slot].step(action)
        if len(result) != 5:
            raise ValueError(f"step: expected 5 values, found {len(result)}")
        observation, reward, terminated, truncated, info = result
        out = self.observations.row()
        self.observations.write(observation, out)
        reward = float(reward)
        flags = TERMINATED * bool(terminated) | TRUNCATED * bool(truncated)
        if self.tells is not None:
            success = self.tells(observation, reward, bool(terminated), info)
            if not isinstance(success, (bool, self.np.bool_)) and success not in (0, 1):
                raise ValueError(f"success: expected true or false, found {success!r}")
            flags |= SUCCESS * bool(success)
        return struct.pack("<HBBf", slot, flags, 0, reward) + out.tobytes()


def time_limit(environment):
    """The longest episode; none where neither a wrapper nor the environment itself says."""
    if environment.spec is not None and environment.spec.max_episode_steps:
        return environment.spec.max_episode_steps
    limit = getattr(environment.unwrapped, "max_steps", None)
    while environment is not environment.unwrapped:
        limit = getattr(environment, "_max_episode_steps", None) or limit
        environment = environment.env
    return limit


def versions():
    found = {"python": ".".join(str(number) for number in sys.version_info[:3])}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            pass
    return found


def turn(environments, body):
    """Resets and steps the slots of a turn, in their order."""
    width = 16 + environments.actions.bytes
    raw = environments.np.frombuffer(body, dtype=environments.np.uint8).reshape(-1, width)
    actions = environments.actions.convert(environments.np.ascontiguousarray(raw[:, 16:]))
    answers = []
    for index, action in enumerate(actions):
        slot, op, _, _, seed = struct.unpack_from("<HBBIQ", body, index * width)
        during = "step" if op == STEP else "reset"
        try:
            if op == STEP:
                answers.append(environments.step(slot, action))
            else:
                answers.append(environments.reset(slot, seed, op == REBUILD))
        except BaseException as error:
            raise Failed(slot, during, error) from error
    return b"".join(answers)


class Failed(Exception):
    """What an environment raised, and where."""

    def __init__(self, slot, during, error):
        super().__init__(slot, during, error)
        self.slot, self.during, self.error = slot, during, error


def failure(slot, during, error):
    words = str(error) if isinstance(error, Refused) else f"{type(error).__name__}: {error}"
    frames = traceback.format_exception(type(error), error, error.__traceback__)
    body = {"slot": slot, "during": during, "error": words, "traceback": "".join(frames)[-8000:]}
    return json.dumps(body).encode()


def main():
    link = take_link()
    try:
        environments = Environments(json.loads(sys.argv[1]))
    except BaseException as error:
        send(link, FAILED, failure(0, "start", error))
        return 1
    send(link, HELLO, json.dumps(environments.hello).encode())
    while (head := receive(link, 5)) is not None:
        length, kind = struct.unpack("<IB", head)
        body = receive(link, length)
        if body is None or kind != TURN:
            return 1
        try:
            answer = turn(environments, body)
        except Failed as failed:
            send(link, FAILED, failure(failed.slot, failed.during, failed.error))
            return 1
        send(link, TURN, answer)
    return 0


sys.exit(main())
