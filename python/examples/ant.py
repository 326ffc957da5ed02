"""Ant Reach (paper, Section 4.5, Table 1 and Appendix C) in MuJoCo: a quadruped walks to a goal.

The ant is Gymnasium's `ant.xml` with the timestep, the contact impedance and the falling goal
marker of the authors' model. `reach` makes the environment. It has no scripted expert; one is
trained on the reward. README.md has the tables.
"""

import pathlib

import gymnasium
import mujoco
import numpy as np
from gymnasium.envs.mujoco import mujoco_env
from gymnasium.spaces import Box
from gymnasium.wrappers import TimeLimit

HORIZON_STEPS = 50
OBSERVATION_LEN = 132
TIMESTEP_S = 0.02
TIMESTEPS_PER_STEP = 5

# Places in an observation.
HEIGHT = 0
ORIENTATION = slice(1, 5)
JOINTS = slice(5, 13)
MARKER_POSITION = slice(13, 16)
MARKER_ORIENTATION = slice(16, 20)
VELOCITY = slice(20, 26)
JOINT_RATES = slice(26, 34)
MARKER_VELOCITY = slice(34, 40)
CONTACT_FORCES = slice(40, 130)
TO_GOAL = slice(130, 132)

# Coordinates of an episode's start without noise: torso, joints, and the marker, whose x and y are
# the goal's. Both quaternions are normalized at the reset.
START = np.array([0, 0, 0.55, 1, 0, 0, 0] + [0, 1, 0, -1, 0, -1, 0, 1] + [0, 0, 0.15, 1, 1, 0, 0], np.float64)
QUATERNIONS = (slice(3, 7), slice(18, 22))
MARKER_XY = slice(15, 17)

GOAL_DISTANCE_M = 5.0
SUCCESS_DISTANCE_M = 0.5
GOAL_BINS = 20
NOISE_MAX = 0.5
VELOCITY_NOISE = 0.005
ACTION_COST = 0.005
CONTACT_FORCE_MAX = 1.0


def reach(coverage=1.0, noise=0.0, contact_forces=False):
    """Ant Reach: walk to within half a meter of a goal five meters away; 50 steps.

    Args:
        coverage: share of the half circle that goals are drawn from, above 0 and at most 1.
        noise: half the width of a uniform draw that is added to every coordinate of the start,
            meters and radians, 0 to 0.5; 0 for the demonstrations.
        contact_forces: whether contact forces are observed; they are zeros in the authors' runs.
    """
    return TimeLimit(Ant(coverage, noise, contact_forces), HORIZON_STEPS)


def model():
    """Gymnasium's ant with what the authors' model has otherwise, and with their goal marker."""
    assets = pathlib.Path(mujoco_env.__file__).parent / "assets"
    spec = mujoco.MjSpec.from_file(str(assets / "ant.xml"))
    spec.option.timestep = TIMESTEP_S
    add_marker(spec.worldbody.add_body(name="goal"))
    for geom in spec.geoms:
        geom.solimp[:3] = [0.8, 0.8, 0.01]
    return spec.compile()


def add_marker(body):
    """A flag on a pole with a box around its foot, 0.6 kg. It collides with the floor only."""
    body.add_freejoint()
    floor_only = {"mass": 0.2, "contype": 1, "conaffinity": 2}
    box, cylinder = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    body.add_geom(type=box, size=[0.5, 0.5, 0.5], **floor_only)
    body.add_geom(type=cylinder, size=[0.08, 0, 0], fromto=[0, -0.3, 0, 0, 1.3, 0], **floor_only)
    body.add_geom(type=box, pos=[0.4, 0.95, 0], size=[0.4, 0.25, 0.05], **floor_only)


def kept_bins(coverage):
    """The bins of nine degrees that a coverage keeps, spread evenly over the half circle.

    The phase makes them the authors' bins for 0.25, 0.5 and 0.75.
    """
    kept = max(1, int(GOAL_BINS * coverage + 0.5))
    edges = np.arange(GOAL_BINS + 1)
    kept_before = (2 * edges * kept + kept + GOAL_BINS // 2) // (2 * GOAL_BINS)
    return np.flatnonzero(np.diff(kept_before))


class Ant(gymnasium.Env):
    """The ant and its goal; observation (132,), action (8,) within [-1, 1]."""

    metadata = {"render_modes": []}

    def __init__(self, coverage, noise, contact_forces):
        if not 0 < coverage <= 1:
            raise ValueError(f"coverage: expected above 0 and at most 1, found {coverage}")
        if not 0 <= noise <= NOISE_MAX:
            raise ValueError(f"noise: expected 0 to {NOISE_MAX}, found {noise}")
        self.bins, self.noise, self.contact_forces = kept_bins(coverage), noise, contact_forces
        self.model = model()
        self.data = mujoco.MjData(self.model)
        self.goal, self.success = np.zeros(2), False
        self.observation_space = Box(-np.inf, np.inf, (OBSERVATION_LEN,), np.float64)
        self.action_space = Box(-1.0, 1.0, (self.model.nu,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.goal, self.success = self.draw_goal(), False
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.draw_start()
        self.data.qvel[:] = self.np_random.uniform(-VELOCITY_NOISE, VELOCITY_NOISE, self.model.nv)
        mujoco.mj_forward(self.model, self.data)
        return self.observation(), {}

    def draw_goal(self):
        """A place (2,) on the half circle around the origin, meters."""
        angle = (self.np_random.choice(self.bins) + self.np_random.random()) * np.pi / GOAL_BINS
        return GOAL_DISTANCE_M * np.array([np.cos(angle), np.sin(angle)])

    def draw_start(self):
        """Coordinates (22,) of the ant and of the marker."""
        start = START + self.np_random.uniform(-self.noise, self.noise, self.model.nq)
        start[MARKER_XY] = self.goal
        for quaternion in QUATERNIONS:
            start[quaternion] /= np.linalg.norm(start[quaternion])
        return start

    def step(self, action):
        self.data.ctrl[:] = np.clip(action, -1.0, 1.0)
        mujoco.mj_step(self.model, self.data, TIMESTEPS_PER_STEP)
        distance_m = np.linalg.norm(self.to_goal())
        self.success = self.success or bool(distance_m < SUCCESS_DISTANCE_M)
        # The goal ends no episode, and the reward has the action as it was given (Appendix G.1).
        reward = 1.0 - distance_m / GOAL_DISTANCE_M - ACTION_COST * np.sum(np.square(action))
        return self.observation(), float(reward), False, False, {"is_success": self.success}

    def to_goal(self):
        """From the torso to the goal (2,), meters."""
        return self.goal - self.data.qpos[:2]

    def observation(self):
        """Coordinates (20,), velocities (20,), contact forces (90,), way to the goal (2,)."""
        forces = np.zeros((self.model.nbody, 6))
        if self.contact_forces:
            mujoco.mj_rnePostConstraint(self.model, self.data)
            forces = np.clip(self.data.cfrc_ext, -CONTACT_FORCE_MAX, CONTACT_FORCE_MAX)
        coordinates, velocities = self.data.qpos[2:], self.data.qvel
        return np.concatenate([coordinates, velocities, forces.ravel(), self.to_goal()])
