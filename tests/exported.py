"""Compares exported models with a run's log: prints the largest differences from what actors and service
recorded, as JSON.

Usage: exported.py RUN EXPORT DISTRIBUTION, which is `squashed` for a squashed Gaussian policy, else empty.
Run by exported.rs; needs requirements.txt beside this file.
"""

import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import tomllib
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

HALF_LOG_TAU = 0.5 * np.log(2 * np.pi)


def messages(run, contents):
    """Reads the messages of a run's log, by topic."""
    found = {}
    for path in sorted((run / "log").glob(f"{contents}-*.mcap")):
        with open(path, "rb") as file:
            for _, channel, _, message in make_reader(
                file, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages():
                found.setdefault(channel.topic, []).append(message)
    return found


def session(path):
    return onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])


def versions(model, updates, name):
    """Returns the versions in the log with the exported weights; several if an update changed nothing."""
    sha256 = model.get_modelmeta().custom_metadata_map["weights_sha256"]
    return {getattr(update, name) for update in updates if update.weights_sha256 == sha256}


def observations(trajectory):
    """Returns all observations, steps + 1 rows."""
    shape = (trajectory.steps + 1, *trajectory.observation_shape)
    if trajectory.cells:
        return np.frombuffer(trajectory.cells, dtype=np.uint8).reshape(shape)
    return np.array(trajectory.values, dtype=np.float32).reshape(shape)


def actions(trajectory):
    """Returns the actions: (steps,) choices, or (steps, numbers) continuous actions."""
    if trajectory.discrete_actions:
        return np.frombuffer(trajectory.discrete_actions, dtype=np.uint8).astype(np.int64)
    return np.array(trajectory.continuous_actions, dtype=np.float32).reshape(trajectory.steps, -1)


def log_probabilities(outputs, taken, squashed):
    if "logits" in outputs:
        logits = outputs["logits"].astype(np.float64)
        normalized = logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))
        return normalized[np.arange(len(taken)), taken]
    mean, logs = outputs["mean"].astype(np.float64), outputs["log_standard_deviation"].astype(np.float64)
    numbers = np.arctanh(np.clip(taken, -1 + 1e-6, 1 - 1e-6)) if squashed else taken
    densities = -0.5 * ((numbers - mean) * np.exp(-logs)) ** 2 - logs - HALF_LOG_TAU
    if squashed:
        densities -= np.log(1 - np.tanh(numbers) ** 2 + 1e-6)
    return densities.sum(axis=1)


def most_probable(model, outputs, squashed):
    """Returns the actions that the environment is to be given, from the parameters of the distribution."""
    if "logits" in outputs:
        return np.argmax(outputs["logits"], axis=1)
    config = tomllib.loads(model.get_modelmeta().custom_metadata_map["config"])
    scale = config["environment"].get("action_scale") or 1.0
    mean = np.tanh(outputs["mean"]) if squashed else outputs["mean"]
    return np.clip(mean * np.array(scale), -1, 1)


def outputs_of(model, inputs):
    names = [output.name for output in model.get_outputs()]
    return dict(zip(names, model.run(None, inputs)))


def larger(one, other):
    """Returns the larger of two differences; refuses what is no number, which `max` may pass over."""
    assert np.isfinite(other), "expected numbers from the model, found NaN or infinity"
    return max(one, other)


def policy(path, log, updates, squashed):
    """Returns the steps compared and the largest difference of log-probabilities, relative where above 1."""
    model = session(path)
    of = versions(model, updates["/policy/update"], "policy_version")
    own = [trajectory for trajectory in log["/trajectory"] if trajectory.policy_version in of]
    steps, difference = 0, 0.0
    for trajectory in own:
        outputs = outputs_of(model, {"observation": observations(trajectory)[:-1]})
        found = log_probabilities(outputs, actions(trajectory), squashed)
        recorded = np.array(trajectory.log_probs)
        relative = np.abs(found - recorded) / np.maximum(1.0, np.abs(recorded))
        difference = larger(difference, relative.max())
        assert np.abs(outputs["action"] - most_probable(model, outputs, squashed)).max() < 1e-6
        steps += trajectory.steps
    return {"steps": steps, "difference": float(difference)}


def rows(model, trajectory, count):
    """Returns an ensemble's inputs for the `count` scored rows: steps, or steps + 1 observations."""
    seen, names = observations(trajectory), [given.name for given in model.get_inputs()]
    scored = np.arange(count)
    if "action" in names and count > trajectory.steps:
        # The action that leads to an observation belongs to its row; the first row repeats the second.
        scored = np.maximum(scored - 1, 0)
    inputs = {"observation": seen[scored]}
    if "next_observation" in names:
        inputs["next_observation"] = seen[scored + 1]
    if "action" in names:
        taken = actions(trajectory)
        width = model.get_inputs()[names.index("action")].shape[1]
        taken = np.eye(width, dtype=np.float32)[taken] if taken.ndim == 1 else taken
        inputs["action"] = taken[scored]
    return inputs


def ensemble(path, log, updates):
    """Returns the rows compared and the largest differences of proximity and uncertainty."""
    model = session(path)
    of = versions(model, updates["/proximity/update"], "model_version")
    trajectories = {(one.lane, one.episode): one for one in log["/trajectory"]}
    count, differences = 0, [0.0, 0.0]
    for score in log["/proximity/score"]:
        if score.model_version not in of:
            continue
        trajectory = trajectories[score.lane, score.episode]
        outputs = outputs_of(model, rows(model, trajectory, len(score.proximity)))
        found = [outputs["proximity"], outputs["standard_deviation"]]
        for at, recorded in enumerate([score.proximity, score.uncertainty]):
            differences[at] = larger(differences[at], np.abs(found[at] - np.array(recorded)).max())
        count += len(score.proximity)
    return {"rows": count, "proximity": float(differences[0]), "uncertainty": float(differences[1])}


def main(run, export, squashed):
    log, updates = messages(run, "trajectories"), messages(run, "updates")
    found = {"policy": policy(export / "policy.onnx", log, updates, squashed)}
    if (export / "ensemble.onnx").exists():
        found["ensemble"] = ensemble(export / "ensemble.onnx", log, updates)
    print(json.dumps(found))


main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3] == "squashed")
