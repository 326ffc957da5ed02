"""Trains a method of the Python library `imitation` on Goalward's environment and demonstrations.

Usage: peers_methods.py {bc,sqil} TASK DEMONSTRATIONS.mcap [--setting JSON] [--steps N] [--seed N] ...

It needs peers_methods_requirements.txt beside this file, and cargo. Every value that both programs have is an
option with Goalward's default. Observations are normalized by the moments of the demonstrations, as Goalward
does for these methods. It prints the success rate of episodes outside the training.
"""

import argparse
import json
import pathlib
import sys
import time

import gymnasium
import numpy as np
import torch
from imitation.algorithms import bc
from imitation.algorithms.sqil import SQIL
from imitation.data.types import Trajectory
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import DummyVecEnv

WORKSPACE = pathlib.Path(__file__).resolve().parents[2]
sys.path.append(str(WORKSPACE / "environments/fidelity"))
from rapier import Goalward  # noqa: E402

# Numbers of the first training and evaluation episodes; neither are demonstrated ones.
TRAINING, EVALUATION = 1_000_000, 2_000_000
CLIP = 10.0


def demonstrations(path):
    """Yields the episodes of a recorded file: observations, one more than actions, and clipped actions."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        setting = json.loads(next(reader.iter_metadata()).metadata["setting"])
        scale = np.array(setting.get("action_scale", 1.0), np.float32)
        for _, _, _, episode in reader.iter_decoded_messages(topics=["/trajectory"]):
            observations = np.array(episode.values, np.float32).reshape(episode.steps + 1, -1)
            actions = np.array(episode.continuous_actions, np.float32).reshape(episode.steps, -1)
            yield observations, np.clip(scale * actions, -1.0, 1.0)


class Normalizer:
    """Normalizes observations by their mean and standard deviation in the demonstrations.

    Numbers whose deviation is below `least` stay as they are.
    """

    def __init__(self, observations, least):
        deviation = np.sqrt(observations.var(0) + 1e-8)
        self.mean = np.where(deviation < least, 0.0, observations.mean(0))
        self.deviation = np.where(deviation < least, 1.0, deviation)

    def __call__(self, observations):
        normal = (observations - self.mean) / self.deviation
        return np.clip(normal, -CLIP, CLIP).astype(np.float32)


class Episodes(gymnasium.Env):
    """Goalward's environment as a Gymnasium environment with normalized observations."""

    def __init__(self, task, setting, normalizer, shapes, first):
        self.inner, self.normalizer, self.number = Goalward(task, **setting), normalizer, first
        self.observation_space = gymnasium.spaces.Box(-CLIP, CLIP, (shapes[0],), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (shapes[1],), np.float32)

    def reset(self, seed=None, options=None):
        self.number += 1
        return self.normalizer(self.inner.begin(self.number)), {}

    def step(self, action):
        observation = self.normalizer(self.inner.step(action))
        ending, success = self.inner.ending, self.inner.success
        terminated, truncated = ending in ("goal reached", "failed"), ending == "truncated"
        return observation, 0.0, terminated, truncated, {"success": success}


def success(policy, episodes, count):
    """Returns the success rate of the most probable actions."""
    found = 0
    for _ in range(count):
        (observation, information), ended = episodes.reset(), False
        while not ended:
            action, _ = policy.predict(observation, deterministic=True)
            observation, _, terminated, truncated, information = episodes.step(action)
            ended = terminated or truncated
        found += information["success"]
    return found / count


class Progress(BaseCallback):
    """Prints the success rate of the last 100 training episodes every `every` steps."""

    def __init__(self, every):
        super().__init__()
        self.every, self.ends, self.begun = every, [], time.monotonic()

    def _on_step(self):
        pairs = zip(self.locals["dones"], self.locals["infos"])
        self.ends += [information["success"] for done, information in pairs if done]
        if self.num_timesteps % self.every == 0 and self.ends:
            rate, seconds = 100 * np.mean(self.ends[-100:]), time.monotonic() - self.begun
            print(f"{self.num_timesteps} steps, {seconds:.0f} s: {rate:.0f} %", flush=True)
        return True


def trained_sqil(options, episodes, trajectories):
    learner = SQIL(
        venv=DummyVecEnv([lambda: episodes]),
        demonstrations=trajectories,
        policy="MlpPolicy",
        rl_algo_class=SAC,
        rl_kwargs={
            "learning_rate": lambda left: 3e-4 * left,
            "batch_size": 2 * options.batch,
            "learning_starts": 5000,
            "ent_coef": "auto_0.1",
            "gradient_steps": 1,
            "train_freq": round(1 / options.updates_per_step),
            "policy_kwargs": {"net_arch": options.hidden},
            "seed": options.seed,
        },
    )
    learner.train(total_timesteps=options.steps, callback=Progress(max(options.steps // 20, 1)))
    return learner.policy


def trained_bc(options, episodes, trajectories):
    policy = ActorCriticPolicy(
        episodes.observation_space,
        episodes.action_space,
        lr_schedule=lambda _: 1e-3,
        net_arch=options.hidden,
    )
    learner = bc.BC(
        observation_space=episodes.observation_space,
        action_space=episodes.action_space,
        rng=np.random.default_rng(options.seed),
        policy=policy,
        demonstrations=trajectories,
        batch_size=options.batch,
        optimizer_kwargs={"lr": 1e-3},
    )
    learner.train(n_epochs=options.epochs, progress_bar=False, log_interval=10**9)
    return learner.policy


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("method", choices=["bc", "sqil"])
    parser.add_argument("task", choices=["fetch-pick", "fetch-push", "ant-reach"])
    parser.add_argument("demonstrations", type=pathlib.Path)
    parser.add_argument("--setting", type=json.loads, default={})
    parser.add_argument("--hidden", type=json.loads, default=[256, 256])
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--updates-per-step", type=float, default=0.25)
    parser.add_argument("--batch", type=int, default=128)
    parser.add_argument("--epochs", type=int, default=50)
    parser.add_argument("--episodes", type=int, default=500)
    parser.add_argument("--least-deviation", type=float, default=0.01)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(options.seed)
    recorded = list(demonstrations(options.demonstrations))
    observations = np.concatenate([observations for observations, _ in recorded])
    normalizer = Normalizer(observations, options.least_deviation)
    shapes = recorded[0][0].shape[1], recorded[0][1].shape[1]
    trajectories = [
        Trajectory(obs=normalizer(observations), acts=actions, infos=None, terminal=True)
        for observations, actions in recorded
    ]
    environment = options.task, options.setting, normalizer, shapes
    train = {"bc": trained_bc, "sqil": trained_sqil}[options.method]
    begun = time.monotonic()
    policy = train(options, Episodes(*environment, TRAINING), trajectories)
    seconds = time.monotonic() - begun
    rate = success(policy, Episodes(*environment, EVALUATION), options.episodes)
    print(
        f"{options.method} {options.task}: {100 * rate:.1f} % of {options.episodes} episodes, "
        f"trained in {seconds:.0f} s"
    )


if __name__ == "__main__":
    main()
