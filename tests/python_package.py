"""Prints what the Python package reads from a run as JSON; writes its demonstrations as a data set of states.

Usage: python_package.py RUN EXPORT DATASET.npz. Run by python_package.rs.
"""

import json
import sys
from pathlib import Path

import gymnasium
import numpy as np

from goalward.demonstrations import read
from goalward.log import Log
from goalward.policy import Policy

run, export, dataset = map(Path, sys.argv[1:])

log = Log(run)
episodes = log.episodes()
trajectories = list(log.trajectories())

states = [episode.observations for episode in read(run / "demonstrations.mcap").episodes]
ends = np.cumsum([len(own) for own in states])
np.savez(dataset, observation=np.concatenate(states), episode_ends=ends)

environment = gymnasium.make("goalward.envs:goalward/FetchPush-v0")
policy = Policy(export / "policy.onnx")
act = policy.for_space(environment.observation_space, environment.action_space, np.random.default_rng(1))
observation, _ = environment.reset(seed=1)
steps, ended = 0, False
while not ended:
    observation, _, terminated, truncated, _ = environment.step(act(observation))
    steps, ended = steps + 1, terminated or truncated
environment.close()

print(
    json.dumps(
        {
            "episodes": len(episodes["steps"]),
            "steps": int(episodes["steps"].sum()),
            "observed": sum(len(trajectory.observations) - 1 for trajectory in trajectories),
            "weights": str(log.updates()["weights_sha256"][-1]),
            "exported": policy.metadata["weights_sha256"],
            "acted": steps,
        }
    )
)
