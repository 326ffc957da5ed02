"""Fetch Pick and Fetch Push (paper, Section 4.4) in MuJoCo, and the scripted experts.

The scene, its solver settings and its actions are those of gymnasium-robotics. Starts and goals are
given, the observation is reduced to the paper's sixteen numbers, and the experts are the authors'.
"""

import gymnasium
import gymnasium_robotics
import mujoco
import numpy as np

gymnasium.register_envs(gymnasium_robotics)

HORIZON_STEPS = {"fetch-pick": 50, "fetch-push": 60}
SUCCESS_RADIUS_M = 0.05

# Indices in an observation of sixteen numbers.
GRIPPER = slice(0, 3)
CUBE = slice(3, 6)
CUBE_FROM_GRIPPER = slice(6, 9)
FINGERS = slice(9, 11)
CUBE_TILT = slice(11, 13)
GOAL = slice(13, 16)


class Fetch:
    """Episodes of a Fetch task; observations and actions are laid out as in Goalward."""

    def __init__(self, task):
        name = {"fetch-pick": "FetchPickAndPlace-v4", "fetch-push": "FetchPush-v4"}[task]
        self.environment = gymnasium.make(name).unwrapped
        self.model, self.data = self.environment.model, self.environment.data
        self.act, self.timesteps = self.environment._set_action, self.environment.n_substeps
        self.fingers_held = task == "fetch-push"
        self.cube = self.model.jnt_qposadr[self.model.joint("object0:joint").id]

    def begin(self, first):
        """Places cube and goal as in the observation `first`; returns the resulting observation."""
        self.environment.reset(seed=0)
        self.data.qpos[self.cube : self.cube + 2] = first[CUBE][:2]
        self.environment.goal = np.array(first[GOAL])
        mujoco.mj_forward(self.model, self.data)
        return self.cut(self.environment._get_obs())

    def step(self, action):
        """Moves the gripper, and in Fetch Pick the fingers, for 0.04 s."""
        action = np.append(action, 0.0) if self.fingers_held else np.asarray(action)
        return self.cut(self.environment.step(action)[0])

    def cut(self, observation):
        return np.concatenate([observation["observation"][:13], self.environment.goal])


def distance(observation):
    """Returns the distance from the cube to the goal, meters."""
    return np.linalg.norm(observation[CUBE] - observation[GOAL])


def succeeded(observation):
    """Returns whether the cube is at the goal."""
    return distance(observation) < SUCCESS_RADIUS_M


class PickExpert:
    """Moves above the cube, down to it, and to the goal, then holds; actions are six times the way left."""

    def __init__(self):
        self.stage = 0

    def way(self, observation):
        """Returns the way left in the current stage, the fingers' action, and the tolerance (m)."""
        return [
            (observation[CUBE_FROM_GRIPPER] + [0, 0, 0.03], 0.05, 0.005),
            (observation[CUBE_FROM_GRIPPER], -0.005, 0.005),
            (observation[GOAL] - observation[CUBE], -0.005, 0.01),
            (np.zeros(3), -0.005, -1.0),
        ][self.stage]

    def action(self, observation):
        way, fingers, near_m = self.way(observation)
        arrived = np.linalg.norm(way) < near_m
        if arrived and self.stage > 0:
            self.stage += 1
            way, fingers, near_m = self.way(observation)
        elif arrived:
            self.stage = 1  # from the next step on, as the authors' loop notices it a step late
        return np.append(6 * way, fingers)


class PushExpert:
    """Moves up, behind the cube, down, and toward the goal; actions are six times the way left."""

    def __init__(self):
        self.stage = 0
        self.targets = None

    def action(self, observation):
        gripper, cube, goal = observation[GRIPPER], observation[CUBE], observation[GOAL]
        if self.targets is None:
            behind = cube + 0.1 * (cube - goal) / np.linalg.norm(cube - goal)
            up = np.array([0, 0, 0.08])
            self.targets = [gripper + up, behind + up, behind, goal]
        way = self.targets[self.stage] - gripper
        if self.stage < 3 and np.linalg.norm(way) < 0.005:
            self.stage += 1  # from the next step on, as the authors' loops notice it a step late
        return 6 * way


EXPERTS = {"fetch-pick": PickExpert, "fetch-push": PushExpert}
