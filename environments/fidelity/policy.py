"""A policy trained by Goalward, such as the expert of Ant Reach."""

import itertools
import json
import pathlib

import numpy as np
import tomllib

KINDS = {"F32": np.float32, "F64": np.float64, "U64": np.uint64}


def tensors(path):
    """Returns the arrays of a safetensors file by name."""
    content = path.read_bytes()
    begin = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:begin])
    return {
        name: np.frombuffer(content[begin + at : begin + end], KINDS[entry["dtype"]])
        for name, entry in header.items()
        if name != "__metadata__"
        for at, end in [entry["data_offsets"]]
    }


ANT_EXPERT = pathlib.Path(__file__).resolve().parents[2] / "environments/experts/ant_reach"


class Policy:
    """The mean action of a policy with tanh hidden layers, as all vector tasks have.

    Its folder holds a run's config.toml and the policy.safetensors of a checkpoint.
    """

    def __init__(self, folder, observation_len=132, action_len=8):
        config = tomllib.loads((folder / "config.toml").read_text())
        arrays = tensors(folder / "policy.safetensors")
        widths = [observation_len, *config["policy"]["hidden"], action_len]
        self.layers = []
        left = arrays["parameters"]
        for inputs, outputs in itertools.pairwise(widths):
            weights, biases, left = np.split(left, [inputs * outputs, (inputs + 1) * outputs])
            self.layers.append((weights.reshape(inputs, outputs), biases))
        self.moments = arrays["moments"].reshape(-1, 3)
        self.scale = np.array(config["environment"].get("action_scale") or [1.0] * action_len)

    def action(self, observation):
        if len(self.moments):
            mean, variance, _ = self.moments.T
            observation = np.clip((observation - mean) / np.sqrt(variance + 1e-8), -10, 10)
        *hidden, (weights, biases) = self.layers
        for weights_, biases_ in hidden:
            observation = np.tanh(observation @ weights_ + biases_)
        return self.scale * (observation @ weights + biases)
