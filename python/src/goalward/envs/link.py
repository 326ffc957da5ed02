"""The process `goalward-actor serve`, and the frames exchanged with it."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import struct
import subprocess
import tempfile
import weakref
from typing import IO, Any

import numpy as np

from goalward.error import Error, expecting, one_line

PROGRAM = "GOALWARD_ACTOR"
"""The environment variable with the program's path."""

HELLO, TURN, FAILED, EXPERT = 1, 2, 3, 4
RESET, STEP = 0, 2
TERMINATED, TRUNCATED, SUCCESS = 1, 2, 4


class Link:
    """A process that runs one environment.

    Attributes:
        hello: the description of the environment: shapes, labels, longest episode.
    """

    def __init__(self, task: str, setting: dict[str, Any]) -> None:
        """Start the process.

        Raises:
            Error: if there is no such program, or it does not know the task or a setting.
        """
        with expecting(f"{task}: expected a setting in JSON", TypeError, ValueError):
            written = json.dumps(setting, default=_plain, allow_nan=False)
        program = _program()
        # A file instead of a pipe, because nobody reads it while the environment is running.
        self._words = tempfile.TemporaryFile()  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                [program, "serve", task, "--setting", written],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._words,
                start_new_session=True,  # Ctrl-C must reach only the calling program
            )
        except OSError as cause:
            self._words.close()
            raise Error(f"expected the program {program} to start, found {one_line(cause)}") from cause
        # An environment that is dropped without being closed leaves no process behind.
        self._end = weakref.finalize(self, _end, self._process, self._words)
        self._end.atexit = False  # then the process sees the end of its input
        try:
            self.hello: dict[str, Any] = json.loads(self._receive(HELLO))
        except BaseException:
            self.close()
            raise

    def reset(self, seed: int) -> tuple[float, int, bytes]:
        """Begin the episode of a seed below 2^31; return the same as `step`."""
        return self._turn(struct.pack("<HBBIQ", 0, RESET, 0, 0, seed) + bytes(self._action_bytes()))

    def step(self, action: bytes) -> tuple[float, int, bytes]:
        """Take an action.

        Returns:
            The reward, flags (`TERMINATED`, `TRUNCATED`, `SUCCESS`), and the bytes of the observation.

        Raises:
            Error: if the environment refuses the action, for example before a reset, which changes nothing;
                or if the environment fails, which ends the process.
        """
        return self._turn(struct.pack("<HBBIQ", 0, STEP, 0, 0, 0) + action)

    def expert_action(self) -> bytes:
        """Return the bytes of the scripted expert's action.

        Raises:
            Error: if there is no such expert, or no episode is running.
        """
        return self._answer(EXPERT, struct.pack("<H", 0))

    def close(self) -> None:
        """End the process."""
        self._end()

    def _action_bytes(self) -> int:
        action = self.hello["action"]
        return 4 * action["continuous"]["len"] if "continuous" in action else 1

    def _turn(self, body: bytes) -> tuple[float, int, bytes]:
        answer = self._answer(TURN, body)
        _, flags, _, reward = struct.unpack_from("<HBBf", answer)
        return reward, flags, answer[8:]

    def _answer(self, kind: int, body: bytes) -> bytes:
        try:
            self._send(kind, body)
            return self._receive(kind)
        except Error:
            raise
        except BaseException:
            # After an interrupt, the next request would receive the answer to this one.
            self.close()
            raise

    def _send(self, kind: int, body: bytes) -> None:
        pipe = self._process.stdin
        if pipe is None or pipe.closed:
            raise Error("expected an environment that is open, found one that was closed")
        try:
            pipe.write(struct.pack("<IB", len(body), kind) + body)
            pipe.flush()
        except BrokenPipeError as cause:
            raise self._ended() from cause

    def _receive(self, expected: int) -> bytes:
        length, kind = struct.unpack("<IB", self._read(5))
        body = self._read(length)
        if kind == FAILED:
            raise Error(json.loads(body)["error"])
        if kind != expected:
            raise Error(f"goalward-actor: expected a frame of kind {expected}, found {kind}")
        return body

    def _read(self, count: int) -> bytes:
        pipe = self._process.stdout
        data = b"" if pipe is None else pipe.read(count)
        if len(data) != count:
            raise self._ended()
        return data

    def _ended(self) -> Error:
        status = self._process.wait()
        self._words.seek(0)
        words = self._words.read().decode(errors="replace")
        how = f"killed by signal {-status}" if status < 0 else f"exit status {status}"
        last = words.strip().splitlines()[-1:] or [how]
        return Error(f"goalward-actor ended: {last[0]}")


def _plain(value: object) -> Any:
    """Return a value of NumPy as one that JSON has."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"a value of type {type(value).__name__}")


def _end(process: subprocess.Popen[bytes], words: IO[bytes]) -> None:
    # Closing its input would end it, too, but a forked child may hold the input open.
    process.terminate()
    # The context closes the pipes and waits; flushing unsent data to a process that has ended may fail.
    with contextlib.suppress(BrokenPipeError), process:
        words.close()


def _program() -> str:
    asked = os.environ.get(PROGRAM) or "goalward-actor"
    found = shutil.which(asked)
    if found is None:
        raise Error(
            f"expected the program goalward-actor in PATH, or where {PROGRAM} says, "
            f"found no program {asked}: `deploy/run_local.sh --only-build` builds it"
        )
    return found
