"""Holds the environments of a Goalward actor and talks to it over file descriptor 0.

A frame is a little-endian length, a kind and a body; `actor/src/frame.rs` has the other half.
This file needs no installation: the actor passes its text to the interpreter.
"""

import contextlib
import ctypes
import functools
import hashlib
import importlib
import inspect
import itertools
import json
import numbers
import os
import random
import signal
import socket
import struct
import sys
import traceback
import types
import zlib
from importlib import metadata

SPACES = "goalward_spaces"  # the module whose text is passed together with this one

HELLO, TURN, FAILED, EXPERT, PICTURE = 1, 2, 3, 4, 5
RESET, REBUILD, STEP = 0, 1, 2
TERMINATED, TRUNCATED, SUCCESS = 1, 2, 4

LARGEST = 400  # maximum pixels of a picture's side

# Packages that environments use, by their modules.
PACKAGES = {
    "gymnasium": ("gymnasium",),
    "numpy": ("numpy",),
    "gymnasium_robotics": ("gymnasium-robotics",),
    "mujoco": ("mujoco",),
    "minigrid": ("minigrid",),
    "Box2D": ("box2d-py", "box2d"),
    "pygame": ("pygame",),
}


def take_link():
    """Returns the socket on descriptor 0. What the environment prints goes to standard error from here on."""
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
    """Reads exactly `count` bytes; returns None at the end of the link."""
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
    """Imports and returns what `module:name` names."""
    module, _, name = reference.partition(":")
    if not name:
        raise sys.modules[SPACES].Refused(f"expected module:function, found {reference}")
    found = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    return found


def loaded(name, text):
    """Makes a module from its text."""
    module = sys.modules[name] = types.ModuleType(name)
    exec(compile(text, f"{name}.py", "exec"), module.__dict__)
    return module


def maker(reference, kwargs, render, refused):
    """Returns what makes the environment `gym:ID`, `gym:module:ID` or `python:module:function`."""
    import gymnasium

    kind, _, name = reference.partition(":")
    if kind == "gym":
        make = functools.partial(gymnasium.make, name)
    elif kind == "python":
        make = imported(name)
    else:
        raise refused(f"expected gym:ID or python:module:function, found {reference}")

    def made():
        if render:
            try:
                return make(**{"render_mode": "rgb_array", **kwargs})
            except Exception as error:  # it may not have this mode, or any
                print(f"made without pictures: {type(error).__name__}: {error}", file=sys.stderr)
        return make(**kwargs)

    return made


def teller(rule):
    """Returns what tells success of (observation, reward, terminated, info); None for the rule `none`."""
    if rule == "none":
        return None
    if rule in ("is_success", "success"):
        # An environment may report success only at the end; until then there is none.
        return lambda seen, reward, terminated, info: info[rule] if terminated else info.get(rule, False)
    if rule == "terminated":
        return lambda seen, reward, terminated, info: terminated
    if rule == "reward":
        return lambda seen, reward, terminated, info: terminated and reward > 0
    if ":" not in rule:
        rules = "auto, none, is_success, success, terminated, reward or module:function"
        raise sys.modules[SPACES].Refused(f"success: expected {rules}, found {rule}")
    return imported(rule)


class Environments:
    """Environments by slot, made when a slot is first used."""

    def __init__(self, options, conversion):
        import gymnasium
        import numpy as np

        self.np, self.renders = np, options["render"]
        self.make = maker(options["environment"], options["kwargs"], self.renders, conversion.Refused)
        self.slots = {}
        first = self.make()
        if not isinstance(first, gymnasium.Env):
            raise conversion.Refused(f"expected a gymnasium.Env, found {type(first).__name__}")
        self.observations = conversion.observations_of(first.observation_space)
        self.actions = conversion.actions_of(first.action_space)
        self.success, self.tells = self.find_success(options["success"])
        self.expert = imported(options["expert"]) if options["expert"] else None
        self.acting, self.seen, self.buffers = {}, {}, {}
        observation, labels = self.observations.layout()
        modules = modules_of(options["environment"], self.success, first)
        self.hello = {
            "observation": observation,
            "action": self.actions.spec,
            "horizon_steps": time_limit(first),
            "labels": labels,
            "dropped": list(self.observations.dropped),
            "success": self.success,
            "versions": versions(modules),
            "sources": sources(modules),
        }
        self.spare = first

    def find_success(self, rule):
        """Returns the rule that tells success, and its function; `auto` is determined by one random step."""
        if rule == "auto":
            environment = self.make()  # a used environment might not start like a new one
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

    def close(self):
        """Closes every environment, so that it releases what it holds, such as a process of its own."""
        for environment in filter(None, [*self.slots.values(), self.spare]):
            with contextlib.suppress(Exception):
                environment.close()

    def reset(self, slot, seed, rebuild, out):
        """Begins an episode and writes its first observation; returns reward and flags."""
        if rebuild and slot in self.slots:
            self.slots.pop(slot).close()
        if slot not in self.slots:
            self.slots[slot] = self.fresh()
        random.seed(seed)
        self.np.random.seed(seed)
        observation, _ = self.slots[slot].reset(seed=seed)
        self.seen[slot] = observation
        self.acting.pop(slot, None)
        self.observations.write(observation, out)
        return 0.0, 0

    def step(self, slot, action, out):
        """Takes a step and writes the observation it leads to; returns reward and flags."""
        result = self.slots[slot].step(action)
        if len(result) != 5:
            raise ValueError(f"step: expected 5 values, found {len(result)}")
        observation, reward, terminated, truncated, info = result
        self.seen[slot] = observation
        self.observations.write(observation, out)
        reward = float(reward)
        flags = TERMINATED * bool(terminated) | TRUNCATED * bool(truncated)
        if self.tells is not None:
            success = self.tells(observation, reward, bool(terminated), info)
            if not isinstance(success, (bool, self.np.bool_)) and success not in (0, 1):
                raise ValueError(f"success: expected true or false, found {success!r}")
            flags |= SUCCESS * bool(success)
        return reward, flags

    def answers(self, count):
        """Returns a buffer of `count` answers, and views of the observations in it to write to."""
        if count not in self.buffers:
            row = self.observations.row()
            layout = [
                ("slot", "<u2"),
                ("flags", "u1"),
                ("", "u1"),
                ("reward", "<f4"),
                ("row", row.dtype, row.shape),
            ]
            buffer = self.np.zeros(count, dtype=layout)
            self.buffers[count] = buffer, list(buffer["row"])
        return self.buffers[count]

    def expert_action(self, slot):
        """Returns the bytes of the expert's action; every episode has an expert of its own."""
        if slot not in self.acting:
            self.acting[slot] = self.expert(self.slots[slot])
        return self.actions.encode(self.acting[slot](self.seen[slot]))

    def picture(self, slot):
        """Returns what the environment renders, as a PNG file; empty if that is not a picture."""
        np, seen = self.np, None
        if self.renders:
            with contextlib.suppress(NotImplementedError):
                seen = self.slots[slot].render()
        if not isinstance(seen, np.ndarray) or seen.dtype != np.uint8 or seen.ndim != 3 or seen.shape[2] < 3:
            return b""
        stride = -(-max(seen.shape[:2]) // LARGEST)
        return png(np, np.ascontiguousarray(seen[::stride, ::stride, :3]))


def png(np, pixels):
    """Encodes RGB pixels as a PNG file."""
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 3 * width), dtype=np.uint8)  # each begins with its filter, 0 for none
    rows[:, 1:] = pixels.reshape(height, 3 * width)

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 3)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


def time_limit(environment):
    """Returns the longest episode; None if neither a wrapper nor the environment itself has a limit."""
    if environment.spec is not None and environment.spec.max_episode_steps:
        return environment.spec.max_episode_steps
    limit = getattr(environment.unwrapped, "max_steps", None)
    limit = limit if isinstance(limit, numbers.Integral) and limit > 0 else None
    while environment is not environment.unwrapped:
        limit = getattr(environment, "_max_episode_steps", None) or limit
        environment = environment.env
    return None if limit is None else int(limit)


def versions(modules):
    """Returns versions of Python, of known packages that were imported, and of those of these modules."""
    found = {"python": ".".join(str(number) for number in sys.version_info[:3])}
    packages = metadata.packages_distributions()
    own = (packages.get(module.partition(".")[0], ()) for module in modules)
    used = (names for module, names in PACKAGES.items() if module in sys.modules)
    for package in itertools.chain(*used, *own):
        version = version_of(package)
        if version is not None:
            found[package] = version
    return found


def version_of(package):
    """Returns the version of a package; None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def modules_of(reference, rule, environment):
    """Names the modules of an environment's maker, of its success function and of its class."""
    named = [reference.partition(":")[2]] if reference.startswith("python:") else []
    named += [rule] if ":" in rule else []
    return [name.partition(":")[0] for name in named] + [type(environment.unwrapped).__module__]


def sources(modules):
    """Returns SHA-256 of the source file of each of these modules that has one."""
    found = {}
    for module in modules:
        path = source_file(module)
        if path is not None:
            with open(path, "rb") as file:
                found[module] = hashlib.sha256(file.read()).hexdigest()
    return found


def source_file(module):
    """Returns a module's source file; None without one, or in an installed package, which has a version."""
    try:
        path = inspect.getsourcefile(sys.modules[module])
    except (KeyError, TypeError):
        return None
    if path is None or not os.path.isfile(path):
        return None
    parts = os.path.abspath(path).split(os.sep)
    return None if "site-packages" in parts or "dist-packages" in parts else path


def advice():
    """Returns what to install, if packages are installed that are known to be incompatible."""
    robotics, mujoco = version_of("gymnasium-robotics"), version_of("mujoco")
    if "gymnasium_robotics" not in sys.modules or robotics is None or mujoco is None:
        return ""
    if tuple(int(part) for part in mujoco.split(".")[:2]) < (3, 12):
        return ""
    return f"; gymnasium-robotics {robotics} does not work with mujoco {mujoco}: pip install 'mujoco<3.12'"


def turn(environments, body):
    """Resets and steps the slots of a turn, in order; returns the answers, concatenated."""
    np = environments.np
    requests = np.frombuffer(body, dtype=np.uint8).reshape(-1, 16 + environments.actions.bytes)
    actions = environments.actions.decode(np.ascontiguousarray(requests[:, 16:]))
    slots = requests[:, :2].copy().view("<u2")[:, 0].tolist()
    answers, rows = environments.answers(len(requests))
    done = []
    for index, (slot, op) in enumerate(zip(slots, requests[:, 2].tolist())):
        try:
            if op == STEP:
                done.append(environments.step(slot, actions[index], rows[index]))
            else:
                seed = int.from_bytes(requests[index, 8:16].tobytes(), "little")
                done.append(environments.reset(slot, seed, op == REBUILD, rows[index]))
        except BaseException as error:
            raise Failed(slot, "step" if op == STEP else "reset", error) from error
    rewards, flags = zip(*done)
    answers["slot"], answers["reward"], answers["flags"] = slots, rewards, flags
    return answers.tobytes()


class Failed(Exception):
    """An error that an environment raised, and where."""

    def __init__(self, slot, during, error):
        super().__init__(slot, during, error)
        self.slot, self.during, self.error = slot, during, error


def failure(slot, during, error):
    refused = getattr(sys.modules.get(SPACES), "Refused", ())
    words = str(error) if isinstance(error, refused) else f"{type(error).__name__}: {error}"
    words += advice()
    frames = traceback.format_exception(type(error), error, error.__traceback__)
    body = {"slot": slot, "during": during, "error": words, "traceback": "".join(frames)[-8000:]}
    return json.dumps(body).encode()


def answered(environments, kind, body):
    """Returns the body of the answer to a frame."""
    if kind == TURN:
        return turn(environments, body)
    slot = struct.unpack("<H", body)[0]
    try:
        return environments.picture(slot) if kind == PICTURE else environments.expert_action(slot)
    except BaseException as error:
        raise Failed(slot, "render" if kind == PICTURE else "expert", error) from error


def main():
    link = take_link()
    try:
        spaces, options = sys.argv[1:]
        environments = Environments(json.loads(options), loaded(SPACES, spaces))
    except BaseException as error:
        send(link, FAILED, failure(0, "start", error))
        return 1
    send(link, HELLO, json.dumps(environments.hello).encode())
    try:
        return serve(link, environments)
    finally:
        environments.close()


def serve(link, environments):
    """Answers frames until the link ends; returns 0 then, or 1 after a frame that cannot be answered."""
    while (head := receive(link, 5)) is not None:
        length, kind = struct.unpack("<IB", head)
        body = receive(link, length)
        if body is None or kind not in (TURN, EXPERT, PICTURE):
            return 1
        try:
            answer = answered(environments, kind, body)
        except Failed as failed:
            send(link, FAILED, failure(failed.slot, failed.during, failed.error))
            return 1
        send(link, kind, answer)
    return 0


sys.exit(main())
