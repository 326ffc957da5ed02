"""A policy that Goalward has trained, read from the newest checkpoint of a run."""

import json
import pathlib
import tomllib

import numpy as np

KINDS = {"F32": np.float32, "F64": np.float64, "U64": np.uint64}


def tensors(path):
    """The arrays of a safetensors file by name."""
    content = path.read_bytes()
    begin = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:begin])
    return {
        name: np.frombuffer(content[begin + at : begin + end], KINDS[entry["dtype"]])
        for name, entry in header.items()
        if name != "__metadata__"
        for at, end in [entry["data_offsets"]]
    }


class Policy:
    """The mean action of the policy of a run; hidden layers with tanh, as all vector tasks have."""

    def __init__(self, run, observation_len=132, action_len=8):
        run = pathlib.Path(run)
        config = tomllib.loads((run / "config.toml").read_text())
        newest = max((run / "checkpoints").iterdir())
        arrays = tensors(newest / "policy.safetensors")
        widths = [observation_len, *config["policy"]["hidden"], action_len]
        self.layers = []
        left = arrays["parameters"]
        for inputs, outputs in zip(widths, widths[1:]):
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
