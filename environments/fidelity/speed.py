"""Steps per second of both sides: one thread, its own processor time, in turns."""

import time

import mujoco
import numpy as np

import ant
import fetch
import table
from goalward import Goalward

ROUNDS = 7
EPISODE_STEPS = 50
STEPS = {"fetch-pick": 800, "fetch-push": 800, "ant-reach": 4000}


def with_gymnasium(world, actions):
    """Seconds of the whole environment of gymnasium-robotics, observations and resets included."""
    begun_s = time.thread_time()
    for number, action in enumerate(actions):
        if number % EPISODE_STEPS == 0:
            world.environment.reset()
        world.environment.step(action)
    return time.thread_time() - begun_s


def bare(world, first, actions):
    """Seconds of MuJoCo's stepping alone: no observation, and resets while the clock stands."""
    seconds = 0
    for episode in np.split(actions, len(actions) // EPISODE_STEPS):
        world.begin(first)
        begun_s = time.thread_time()
        for action in episode:
            world.act(action)
            mujoco.mj_step(world.model, world.data, world.timesteps)
        seconds += time.thread_time() - begun_s
    return seconds


def rates(task):
    """Steps per second in rounds: MuJoCo alone, with Gymnasium if there is one, and Goalward."""
    world = ant.Ant() if task == "ant-reach" else fetch.Fetch(task)
    goalward, steps = Goalward(task), STEPS[task]
    actions = np.random.default_rng(1).uniform(-1, 1, (steps, 8 if task == "ant-reach" else 4))
    first = goalward.begin(0)
    rounds = []
    for _ in range(ROUNDS):
        seconds = [bare(world, first, actions)]
        if task != "ant-reach":
            seconds.append(with_gymnasium(world, actions))
        seconds.append(goalward.thread_s(4 * steps) / 4)
        rounds.append([steps / second for second in seconds])
    return np.transpose(rounds)


def speed():
    rows = []
    for task in STEPS:
        *theirs, ours = rates(task)
        for name, rates_ in zip(["`mj_step` alone", "with Gymnasium"], theirs):
            times = f"x {np.median(ours / rates_):.2f}"
            measure = f"steps per second, {task}, MuJoCo {name}"
            rows.append(table.row(measure, spread(rates_), spread(ours), times))
    return rows


def spread(rates_):
    return f"{np.median(rates_):,.0f} ({np.min(rates_):,.0f} to {np.max(rates_):,.0f})"
