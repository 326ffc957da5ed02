"""Plays an episode on one side, or the same episodes on both."""

import numpy as np


def play(world, observation, choose, steps_max, until=lambda observation: False):
    """Returns the observations of an episode in rows, the first included; `choose` gives the actions."""
    observations = [observation]
    while len(observations) <= steps_max and not until(observation):
        observation = world.step(choose(observation))
        observations.append(observation)
    return np.array(observations)


def play_both(mujoco, goalward, episode, choosers, steps_max, until=lambda observation: False):
    """Plays the same episode on both sides; `choosers` makes a fresh `choose` for each."""
    first = goalward.begin(episode)
    ours = play(goalward, first, choosers(), steps_max, until)
    return play(mujoco, mujoco.begin(first), choosers(), steps_max, until), ours


def in_turn(actions):
    """Returns a maker of `choose` that plays the same actions whatever is observed."""

    def chooser():
        left = iter(actions)
        return lambda observation: next(left)

    return chooser
