"""Measurements of Ant Reach: the passive ant, its response to torques, and a trained expert."""

import ant
import numpy as np
import table
from play import in_turn, play_both
from rapier import Goalward

AMPLITUDES = [0.1, 0.3, 1.0]
SEQUENCES = 10


def settling():
    """No torque from the start on: a drop of a few centimeters, then a passive stand."""
    still = in_turn(np.zeros((ant.HORIZON_STEPS, 8)))
    both = play_both(ant.Ant(), Goalward("ant-reach"), 0, still, ant.HORIZON_STEPS)
    rows = [
        table.numbers(
            f"height of the torso without torque after {steps * ant.STEP_S:.1f} s, m",
            *(o[steps, ant.HEIGHT] for o in both),
            digits=3,
        )
        for steps in [4, 10, 20, 50]
    ]
    ankles = [np.mean(np.abs(o[50, ant.JOINTS][1::2])) for o in both]
    rows.append(table.numbers("angle of the ankles after 5.0 s, rad", *ankles, digits=3))
    drift = [np.linalg.norm(ant.torso_xy(o)[50] - ant.torso_xy(o)[0]) for o in both]
    rows.append(table.numbers("drift after 5.0 s, m", *drift, digits=3))
    return rows


def errors(observations, reference):
    """Errors of a trajectory: joints after one step and on average (rms, rad), height and position (m)."""
    apart = observations - reference
    joints = np.sqrt(np.mean(apart[1:, ant.JOINTS] ** 2, axis=1))
    place = np.linalg.norm(ant.torso_xy(observations) - ant.torso_xy(reference), axis=1)[1:]
    return joints[0], np.mean(joints), np.mean(np.abs(apart[1:, ant.HEIGHT])), np.mean(place)


def torque_sequences():
    """Differences from MuJoCo's trajectory; for scale, those of MuJoCo at a quarter of the timestep."""
    reference, finer, goalward = ant.Ant(), ant.Ant(ant.TIMESTEP_S / 4), Goalward("ant-reach")
    draws = np.random.default_rng(1)
    rows = []
    for amplitude in AMPLITUDES:
        found = []
        for episode in range(SEQUENCES):
            torques = in_turn(draws.uniform(-amplitude, amplitude, (ant.HORIZON_STEPS, 8)))
            other, _ = play_both(finer, goalward, episode, torques, ant.HORIZON_STEPS)
            own, ours = play_both(reference, goalward, episode, torques, ant.HORIZON_STEPS)
            found.append([errors(other, own), errors(ours, own)])
        yardstick, ours = np.mean(found, axis=0)
        names = ["joints after the first step, rad", "joints, rad", "height, m", "place, m"]
        for name, *both in zip(names, yardstick, ours):
            rows.append(table.numbers(f"amplitude {amplitude}: error of {name}", *both, digits=3))
    return rows


def gait(observations):
    """Travel, height (mean, least, most), speed, joint velocities, share of time on its back, depth."""
    probe = ant.Ant()
    place, height = ant.torso_xy(observations), observations[:, ant.HEIGHT]
    x, y = observations[:, ant.ORIENTATION][:, 1:3].T
    return [
        np.linalg.norm(place[-1] - place[0]),
        np.mean(height),
        np.min(height),
        np.max(height),
        np.mean(np.linalg.norm(observations[:, ant.VELOCITY], axis=1)),
        np.mean(np.abs(observations[:, ant.JOINT_RATES])),
        np.mean(1 - 2 * (x**2 + y**2) < 0),
        max(probe.depth(observation) for observation in observations),
    ]


def random_torques(episodes):
    """Fifty steps of random torques, the same on both sides."""
    mujoco, goalward = ant.Ant(), Goalward("ant-reach")
    draws = np.random.default_rng(2)
    found = []
    for episode in range(episodes):
        torques = in_turn(draws.uniform(-1, 1, (ant.HORIZON_STEPS, 8)))
        both = play_both(mujoco, goalward, episode, torques, ant.HORIZON_STEPS)
        found.append([gait(observations) for observations in both])
    names = [
        "travel of the torso in 5 s, m",
        "mean height, m",
        "least height, m",
        "largest height, m",
        "mean speed, m/s",
        "mean rate of a joint, rad/s",
        "share of time on its back",
        "largest depth in the floor, m",
    ]
    found = np.transpose(found, (2, 1, 0))
    rows = [table.samples(f"random torques: {name}", *both) for name, both in zip(names, found)]
    deepest = [np.max(depths) for depths in found[-1]]
    return [*rows, table.numbers("random torques: deepest of all episodes, m", *deepest, digits=3)]


def expert(policy, episodes):
    """A policy trained in Goalward, whose mean actions act on both sides."""
    mujoco, goalward = ant.Ant(), Goalward("ant-reach")
    reached, steps, speeds = [], [], []
    for episode in range(episodes):
        both = play_both(mujoco, goalward, episode, lambda: policy.action, ant.HORIZON_STEPS)
        near = [np.linalg.norm(o[:, ant.TO_GOAL], axis=1) < 0.5 for o in both]
        reached.append([np.any(there) for there in near])
        steps.append([np.argmax(there) if np.any(there) else 50 for there in near])
        speeds.append([np.mean(np.linalg.norm(o[:, ant.VELOCITY][:, :2], axis=1)) for o in both])
    return [
        table.shares(f"the expert reaches the goal, {episodes} episodes", *np.transpose(reached)),
        table.samples("steps until it does, 50 if never", *np.transpose(steps)),
        table.samples("its mean speed over 5 s, m/s", *np.transpose(speeds)),
    ]
