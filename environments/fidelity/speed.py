"""Steps per second of both sides: the processor time of one thread, measured in turns."""

import time

import ant
import fetch
import gymnasium
import mujoco
import numpy as np
import table
from rapier import Goalward

ROUNDS = 7
EPISODE_STEPS = 50
STEPS = {"fetch-pick": 800, "fetch-push": 800, "ant-reach": 4000}


def with_gymnasium(environment, actions):
    """Returns the seconds of a whole environment, observations and resets included."""
    begun_s = time.thread_time()
    for number, action in enumerate(actions):
        if number % EPISODE_STEPS == 0:
            environment.reset()
        environment.step(action)
    return time.thread_time() - begun_s


def bare(world, first, actions):
    """Returns the seconds of MuJoCo's stepping alone: no observations, and resets are not timed."""
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
    """Returns steps per second in each round: MuJoCo alone, with Gymnasium, and Goalward."""
    if task == "ant-reach":
        world = ant.Ant()
        environment = gymnasium.make("Ant-v5").unwrapped
    else:
        world = fetch.Fetch(task)
        environment = world.environment
    goalward, steps = Goalward(task), STEPS[task]
    actions = np.random.default_rng(1).uniform(-1, 1, (steps, 8 if task == "ant-reach" else 4))
    first = goalward.begin(0)
    rounds = []
    for _ in range(ROUNDS):
        seconds = [
            bare(world, first, actions),
            with_gymnasium(environment, actions),
            goalward.thread_s(4 * steps) / 4,
        ]
        rounds.append([steps / second for second in seconds])
    return np.transpose(rounds)


def speed():
    rows = []
    for task in STEPS:
        *theirs, ours = rates(task)
        gymnasium_name = "Gymnasium's Ant-v5" if task == "ant-reach" else "MuJoCo with Gymnasium"
        for name, rates_ in zip(["MuJoCo `mj_step` alone", gymnasium_name], theirs):
            times = f"x {np.median(ours / rates_):.2f}"
            measure = f"steps per second, {task}, {name}"
            rows.append(table.row(measure, spread(rates_), spread(ours), times))
    return rows


def spread(rates_):
    return f"{np.median(rates_):,.0f} ({np.min(rates_):,.0f} to {np.max(rates_):,.0f})"
