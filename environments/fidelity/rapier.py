"""Goalward's side: the same tasks in rapier, run by `environments/examples/pipe.rs`."""

import functools
import json
import pathlib
import subprocess

import numpy as np

WORKSPACE = pathlib.Path(__file__).resolve().parents[2]
BUILD = "cargo build --release --package environments --example pipe --message-format json"


@functools.cache
def executable():
    """Builds the example and returns its path."""
    done = subprocess.run(BUILD.split(), cwd=WORKSPACE, check=True, stdout=subprocess.PIPE, text=True)
    messages = [json.loads(line) for line in done.stdout.splitlines()]
    return next(message["executable"] for message in messages if message.get("executable"))


class Goalward:
    """Episodes of a task; every keyword argument is a key of its setting."""

    def __init__(self, task, **setting):
        self.process = subprocess.Popen(
            [executable(), task, json.dumps(setting)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.ending, self.success = "not begun", False

    def begin(self, episode):
        """Begins the episode with this number and returns its first observation."""
        return self.state({"reset": episode})

    def step(self, action):
        return self.state({"step": [float(number) for number in action]})

    def expert_action(self):
        """Returns the action of the task's own expert in the current state."""
        return np.array(self.ask("expert")["action"])

    def thread_s(self, steps):
        """Returns the processor seconds of `steps` random steps, resets included."""
        return self.ask({"time": steps})["thread_s"]

    def state(self, request):
        answer = self.ask(request)
        self.ending, self.success = answer["ending"], answer["success"]
        return np.array(answer["observation"])

    def ask(self, request):
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        if not answer:
            raise RuntimeError(f"no answer to {request}: the example has ended, see its message")
        return json.loads(answer)
