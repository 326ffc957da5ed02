"""Fetch Pick and Fetch Push (paper, Section 4.4, Table 1 and Appendix C) in MuJoCo.

The scenes are those of Gymnasium-Robotics' `FetchPickAndPlace-v4` and `FetchPush-v4`. Starts and
goals, observation, action, horizon and ending are those of the paper. `pick` and `push` make the
environments; `pick_expert` and `push_expert` make their scripted experts. README.md has the tables.
"""

import itertools

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box
from gymnasium.wrappers import TimeLimit
from gymnasium_robotics.envs.fetch.pick_and_place import MujocoFetchPickAndPlaceEnv
from gymnasium_robotics.envs.fetch.push import MujocoFetchPushEnv

PICK_HORIZON_STEPS = 50
PUSH_HORIZON_STEPS = 60
OBSERVATION_LEN = 16

# Places in an observation.
GRIP = slice(0, 3)
CUBE = slice(3, 6)
CUBE_FROM_GRIP = slice(6, 9)
FINGERS = slice(9, 11)
CUBE_TILT = slice(11, 13)
GOAL = slice(13, 16)

# Starts and goals: bins along each side of a rectangle, the centers of the rectangles along y from
# the gripper's start, and how far the goal of Fetch Pick is above the table's, meters.
BINS = 4
CUBE_SIDE_M = 0.1
GOAL_SIDE_M = -0.1
PICK_GOAL_LIFT_M = 0.15
COVERAGES = (0.25, 0.5, 0.75, 1.0)
NOISE_MAX = 3.0

# Half extents along x, then limits along y of the cube and of the goal, meters.
ONE_SIDED = (0.05, (0.0, 0.04), (-0.04, 0.0))
PICK_RANGES = {"symmetric": (0.02, (-0.02, 0.02), (-0.02, 0.02)), "one-sided": ONE_SIDED}
PUSH_RANGES = {"symmetric": (0.05, (-0.02, 0.02), (-0.02, 0.02)), "one-sided": ONE_SIDED}
GOAL_HALF_X_M = 0.05

# Experts: action for every meter of distance, and the distance at which a stage is over, meters.
GAIN = 6.0
TOLERANCE_M = 0.005
HOVER_M = np.array([0.0, 0.0, 0.03])
LIFT_M = np.array([0.0, 0.0, 0.08])
RUN_UP_M = 0.1
OPEN = [0.05]
CLOSE = [-0.005]


def pick(coverage=1.0, noise=1.0, ranges="symmetric"):
    """Fetch Pick: grasp the cube and lift it to a goal in the air, within 50 steps.

    Args:
        coverage: share of the bins of cubes and of goals that is drawn from: 0.25, 0.5, 0.75 or 1.
        noise: factor of their ranges, 0 to 3; 1 for the demonstrations.
        ranges: "symmetric" around their centers, as the paper says, or "one-sided", away from the
            gripper, as in the authors' code.
    """
    starts = Starts(PICK_RANGES, coverage, noise, ranges)
    environment = Fetch(MujocoFetchPickAndPlaceEnv(), 4, PICK_GOAL_LIFT_M, starts)
    return TimeLimit(environment, PICK_HORIZON_STEPS)


def push(coverage=1.0, noise=1.0, ranges="symmetric"):
    """Fetch Push: push the cube to a goal on the table, within 60 steps; arguments as of `pick`."""
    starts = Starts(PUSH_RANGES, coverage, noise, ranges)
    environment = Fetch(MujocoFetchPushEnv(), 3, 0.0, starts)
    return TimeLimit(environment, PUSH_HORIZON_STEPS)


class Starts:
    """Where cubes and goals lie: rectangles of 4 x 4 bins, some of which a coverage keeps."""

    def __init__(self, known, coverage, noise, ranges):
        if ranges not in known:
            raise ValueError(f"ranges: expected one of {sorted(known)}, found {ranges!r}")
        if coverage not in COVERAGES:
            raise ValueError(f"coverage: expected one of {COVERAGES}, found {coverage}")
        if not 0 <= noise <= NOISE_MAX:
            raise ValueError(f"noise: expected 0 to {NOISE_MAX}, found {noise}")
        cube_half_x, cube_y, goal_y = known[ranges]
        self.cube = rectangle(cube_half_x, cube_y, noise, CUBE_SIDE_M)
        self.goal = rectangle(GOAL_HALF_X_M, goal_y, noise, GOAL_SIDE_M)
        self.rows = kept_rows(coverage)

    def draw(self, random):
        """Offsets (2,) of cube and goal from the gripper's start along x and y, meters."""
        return self.draw_from(self.cube, random), self.draw_from(self.goal, random)

    def draw_from(self, corners, random):
        column = random.integers(BINS)
        row = random.choice(self.rows[column])
        share = (np.array([column, row]) + random.random(2)) / BINS
        return corners[0] + share * (corners[1] - corners[0])


def rectangle(half_x_m, y_m, noise, side_m):
    """The lower and the upper corner (2, 2) of a stretched rectangle, from the gripper's start."""
    lower, upper = [-half_x_m, y_m[0]], [half_x_m, y_m[1]]
    return noise * np.array([lower, upper]) + [0.0, side_m]


def kept_rows(coverage):
    """The bins of y that a coverage keeps beside each bin of x: sets in lexicographic order."""
    sets = list(itertools.combinations(range(BINS), round(BINS * coverage)))
    return [sets[column % len(sets)] for column in range(BINS)]


class Fetch(gymnasium.Env):
    """A Fetch scene with the paper's starts, goals, observation (16,) and action (4,) or (3,)."""

    metadata = {"render_modes": []}

    def __init__(self, scene, action_len, goal_lift_m, starts):
        self.scene, self.starts = scene, starts
        self.observation_space = Box(-np.inf, np.inf, (OBSERVATION_LEN,), np.float64)
        self.action_space = Box(-1.0, 1.0, (action_len,), np.float32)
        self.grip_start = scene.initial_gripper_xpos
        self.goal_height = scene.height_offset + goal_lift_m

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        # What the scene draws itself is overwritten; a seed keeps chance out of it all the same.
        self.scene.reset(seed=0)
        cube, goal = self.starts.draw(self.np_random)
        self.scene.data.joint("object0:joint").qpos[:2] = self.grip_start[:2] + cube
        self.scene.goal = np.append(self.grip_start[:2] + goal, self.goal_height)
        mujoco.mj_forward(self.scene.model, self.scene.data)
        return self.cut(self.scene._get_obs()), {}

    def step(self, action):
        full = np.zeros(4)
        full[: len(action)] = action
        seen, _, _, _, info = self.scene.step(full)
        success = bool(info["is_success"])
        return self.cut(seen), float(success) - 1.0, success, False, {"is_success": success}

    def cut(self, seen):
        """The paper's 16 numbers of the scene's observation, whose first 13 hold no velocity."""
        return np.concatenate([seen["observation"][:13], seen["desired_goal"]])

    def close(self):
        self.scene.close()


def pick_expert(environment):
    """The script of Fetch Pick for one episode of `environment`, to be called after its reset.

    Over the cube with open fingers; down around it while they close; with the cube to the goal.

    Returns:
        `act(observation) -> action`: from an observation (16,) an action (4,) within [-1, 1].
    """
    stages = [
        lambda seen: (seen[CUBE_FROM_GRIP] + HOVER_M, OPEN),
        lambda seen: (seen[CUBE_FROM_GRIP], CLOSE),
        lambda seen: (seen[GOAL] - seen[CUBE], CLOSE),
    ]
    return follow(stages)


def push_expert(environment):
    """The script of Fetch Push for one episode of `environment`, to be called after its reset.

    Up; over a point behind the cube, seen from the goal; down; the gripper to the goal.

    Returns:
        `act(observation) -> action`: from an observation (16,) an action (3,) within [-1, 1].
    """
    up = environment.unwrapped.grip_start + LIFT_M
    stages = [
        lambda seen: (up - seen[GRIP], []),
        lambda seen: (behind(seen) + LIFT_M - seen[GRIP], []),
        lambda seen: (behind(seen) - seen[GRIP], []),
        lambda seen: (seen[GOAL] - seen[GRIP], []),
    ]
    return follow(stages)


def behind(seen):
    """The point (3,) that pushing begins at, meters."""
    away = seen[CUBE] - seen[GOAL]
    return seen[CUBE] + RUN_UP_M * away / np.linalg.norm(away)


def follow(stages):
    """Acts out stages in turn; each gives the way left (3,), meters, and the fingers' action."""
    left = list(stages)

    def act(seen):
        while len(left) > 1 and np.linalg.norm(left[0](seen)[0]) < TOLERANCE_M:
            del left[0]
        way, fingers = left[0](seen)
        # Scaled down as a whole: clipped number by number, it would leave the straight way.
        pull = GAIN * way / max(1.0, GAIN * np.abs(way).max())
        return np.concatenate([pull, fingers]).astype(np.float32)

    return act
