"""Converts observations and actions of Gymnasium to the bytes that Goalward uses, and back.

An actor passes this text to its Python process; the package `goalward` contains it, too.
"""

from typing import Any

import numpy as np
from gymnasium import spaces

MOST_NUMBERS = 4096  # per observation; images would fill the log
MOST_CHOICES = 256  # of a discrete action, which is one byte


class Refused(Exception):
    """Something in the environment that a task cannot have."""


def is_text(space):
    """Returns whether the samples of a space that is not one of Gymnasium's own are strings."""
    try:
        return isinstance(space.sample(), str)
    except Exception:
        return False


class Numbers:
    """Converts observations to vectors of numbers: the parts of an observation, concatenated."""

    def __init__(self, space):
        self.labels, self.dropped, self.parts = [], [], []
        self.add(space, "", lambda observation: observation)
        if len(self.labels) > MOST_NUMBERS:
            raise Refused(
                f"expected at most {MOST_NUMBERS} numbers in an observation, found {len(self.labels)}: "
                "images are not supported; wrap the environment so that it gives a vector"
            )
        if not self.labels:
            raise Refused(f"expected an observation of numbers, found {space}")
        self.write = self.parts[0][1] if len(self.parts) == 1 else self.write_parts

    def add(self, space, path, of):
        name = path or "observation"
        if isinstance(space, spaces.Dict):
            for key, inner in space.spaces.items():
                self.add(
                    inner, f"{path}/{key}" if path else str(key), lambda seen, of=of, key=key: of(seen)[key]
                )
        elif isinstance(space, spaces.Tuple):
            for index, inner in enumerate(space.spaces):
                self.add(
                    inner,
                    f"{path}/{index}" if path else str(index),
                    lambda seen, of=of, index=index: of(seen)[index],
                )
        elif isinstance(space, (spaces.Box, spaces.MultiBinary)):
            shape = tuple(space.shape)
            count = int(np.prod(shape, dtype=np.int64))
            self.label(name, count)

            def write(seen, out):
                value = of(seen)
                if getattr(value, "shape", None) != shape:
                    value = np.asarray(value)
                if value.shape != shape:
                    raise ValueError(f"{name}: expected shape {shape}, found {value.shape}")
                out[:] = value if len(shape) == 1 else value.ravel()

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
        return np.empty(len(self.labels), dtype="<f4")

    def write_parts(self, seen, out):
        at = 0
        for count, write in self.parts:
            write(seen, out[at : at + count])
            at += count


class Cells:
    """Converts observations to grids of cell classes."""

    dropped = ()

    def __init__(self, space):
        self.shape = tuple(space.shape)
        self.classes = int(space.high.reshape(-1)[0]) + 1

    @staticmethod
    def fits(space):
        """Returns whether a space is a grid of classes: a matrix of integers from 0 to one common maximum."""
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
        return np.empty(self.shape[0] * self.shape[1], dtype=np.uint8)

    def write(self, seen, out):
        value = np.asarray(seen)
        if value.shape != self.shape:
            raise ValueError(f"observation: expected shape {self.shape}, found {value.shape}")
        known = (value >= 0) & (value < self.classes) & (value == np.floor(value))
        if not known.all():
            raise ValueError(
                f"observation: expected classes below {self.classes}, found {value[~known].reshape(-1)[0]}"
            )
        out[:] = value.reshape(-1)


def observations_of(space: Any) -> Any:
    """Returns the converter of observations of a space to bytes."""
    return Cells(space) if Cells.fits(space) else Numbers(space)


def array_of(action, space, kinds):
    """Returns an action of a space as an array; refuses one whose dtype kind is not in `kinds`."""
    try:
        array = np.asarray(action)
    except ValueError:  # rows of different lengths
        array = None
    if array is None or array.dtype.kind not in kinds:
        raise ValueError(f"action: expected one of {space}, found {action!r}")
    return array


class Numbered:
    """Actions of bounded numbers, each of which Goalward maps to [-1, 1]."""

    def __init__(self, space):
        self.space = space
        low, high = space.low.astype(np.float64), space.high.astype(np.float64)
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            raise Refused(
                f"expected bounded actions, found {space}; gymnasium.wrappers.TransformAction gives it bounds"
            )
        count = int(np.prod(space.shape, dtype=np.int64))
        self.spec, self.bytes = {"continuous": {"len": count}}, 4 * count
        self.half, self.middle = (high - low).reshape(-1) / 2, (high + low).reshape(-1) / 2

    def decode(self, raw):
        """Converts rows of bytes to actions of the environment."""
        numbers = raw.view("<f4") * self.half + self.middle
        if np.issubdtype(self.space.dtype, np.integer):
            numbers = np.rint(numbers)  # single precision may have left a number just below an integer
        numbers = numbers.astype(self.space.dtype).reshape(-1, *self.space.shape)
        return np.minimum(np.maximum(numbers, self.space.low), self.space.high)

    def encode(self, action):
        """Converts an action of the environment to bytes."""
        numbers = array_of(action, self.space, "biuf")
        if numbers.shape != self.space.shape:
            raise ValueError(f"action: expected shape {self.space.shape}, found {numbers.shape}")
        half = np.where(self.half > 0, self.half, 1.0)
        return ((numbers.reshape(-1) - self.middle) / half).astype("<f4").tobytes()


class Chosen:
    """Actions that are one choice, or several choices that Goalward combines into one."""

    bytes = 1

    def __init__(self, space):
        self.space = space
        self.starts = np.asarray(getattr(space, "start", 0), dtype=np.int64).reshape(-1)
        if isinstance(space, spaces.Discrete):
            self.sizes = [int(space.n)]
        elif isinstance(space, spaces.MultiBinary):
            self.sizes = [2] * int(np.prod(space.shape, dtype=np.int64))
        else:
            self.sizes = [int(size) for size in space.nvec.reshape(-1)]
        choices = int(np.prod(self.sizes, dtype=object))
        if choices > MOST_CHOICES:
            raise Refused(f"expected at most {MOST_CHOICES} choices of an action, found {choices}")
        self.spec = {"discrete": {"count": choices}}

    def decode(self, raw):
        """Converts rows of bytes to actions of the environment."""
        if isinstance(self.space, spaces.Discrete):
            return (raw[:, 0] + self.starts).tolist()
        digits = np.stack(np.unravel_index(raw[:, 0], self.sizes), axis=1) + self.starts
        return list(digits.astype(self.space.dtype).reshape(-1, *self.space.shape))

    def encode(self, action):
        """Converts an action of the environment to its byte."""
        choices = array_of(action, self.space, "biu").reshape(-1)
        within = len(choices) == len(self.sizes) and all(
            0 <= digit < size for digit, size in zip(choices - self.starts, self.sizes)
        )
        if not within:
            raise ValueError(f"action: expected one of {self.space}, found {action!r}")
        digits = (choices - self.starts).astype(np.int64)
        return bytes([int(np.ravel_multi_index(tuple(digits), self.sizes))])


def actions_of(space: Any) -> Any:
    """Returns the converter between bytes and actions of a space."""
    if isinstance(space, spaces.Box):
        return Numbered(space)
    if isinstance(space, (spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)):
        return Chosen(space)
    raise Refused(f"expected actions that are numbers or choices, found {space}")
