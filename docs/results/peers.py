"""Measures steps per second of Stable-Baselines3's PPO on the MuJoCo originals of FETCH PUSH and ANT REACH.

Usage: peers.py [UPDATES]      (needs peers_requirements.txt beside this file)

The sizes are the paper's: two hidden layers of 256, 4,096 steps an update for Fetch and 16,000 for the ant,
ten epochs of 32 minibatches. There are as many environment processes and PyTorch threads as cores. The
measured wall time has rollouts and updates, but not the start.
"""

import os
import sys
import time

import gymnasium
import gymnasium_robotics
import torch
from gymnasium.wrappers import FlattenObservation
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import SubprocVecEnv

CORES = len(os.sched_getaffinity(0))
TASKS = {"FetchPush-v4": 4096, "Ant-v5": 16000}
EPISODE_STEPS = 50


class Started(BaseCallback):
    """Records when the first rollout begins, once processes and networks have been made."""

    def _on_rollout_start(self):
        if not hasattr(self, "time_s"):
            self.time_s = time.perf_counter()

    def _on_step(self):
        return True


def environment(name):
    gymnasium.register_envs(gymnasium_robotics)
    inner = gymnasium.make(name, max_episode_steps=EPISODE_STEPS)
    return FlattenObservation(inner) if name.startswith("Fetch") else inner


def rate(name, steps, updates):
    environments = SubprocVecEnv([lambda: environment(name)] * CORES)
    learner = PPO(
        "MlpPolicy",
        environments,
        n_steps=steps // CORES,
        batch_size=steps // 32,
        n_epochs=10,
        policy_kwargs={"net_arch": [256, 256]},
        device="cpu",
    )
    started = Started()
    learner.learn(steps * updates, callback=started)
    seconds = time.perf_counter() - started.time_s
    environments.close()
    # If the cores do not divide the steps of an update, rollouts are shorter, and there is one more.
    return learner.num_timesteps / seconds


def main():
    updates = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    torch.set_num_threads(CORES)
    for name, steps in TASKS.items():
        print(f"{name}: {rate(name, steps, updates):,.0f} steps/s on {CORES} cores")


if __name__ == "__main__":
    main()
