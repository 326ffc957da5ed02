"""The ant of Ant Reach (paper, Section 4.5) in MuJoCo: a quadruped of capsules driven by torques.

The model is written here from its published numbers: a ball and twelve capsules of density 5, eight
hinges of armature 1 and damping 1 driven by torques of up to 150, contact with the floor only. The
goal marker, a free body that touches nothing, is left out; observations show it at its starting place.
"""

import mujoco
import numpy as np

HORIZON_STEPS = 50
TIMESTEPS_PER_STEP = 5
TIMESTEP_S = 0.02
STEP_S = TIMESTEPS_PER_STEP * TIMESTEP_S

# Indices in an observation of 132 numbers.
HEIGHT = 0
ORIENTATION = slice(1, 5)
JOINTS = slice(5, 13)
MARKER = slice(13, 20)
GOAL_XY = slice(13, 15)
VELOCITY = slice(20, 23)
JOINT_RATES = slice(26, 34)
TO_GOAL = slice(130, 132)

# Direction of each leg, axis of its ankle, and range of its ankle in degrees.
LEGS = [
    ((+1, +1), (-1, 1, 0), (30, 70)),
    ((-1, +1), (1, 1, 0), (-70, -30)),
    ((-1, -1), (-1, 1, 0), (-70, -30)),
    ((+1, -1), (1, 1, 0), (30, 70)),
]
MOTORS = ["hip_4", "ankle_4", "hip_1", "ankle_1", "hip_2", "ankle_2", "hip_3", "ankle_3"]


def leg(number, direction, axis, ankle_range):
    """Returns a capsule fixed to the torso, one on a hip that turns around z, and one on an ankle."""
    x, y = (0.2 * part for part in direction)
    capsule = '<geom type="capsule" size="0.08" fromto="0 0 0 {} {} 0"/>'.format
    hinge = '<joint name="{}_{}" type="hinge" axis="{} {} {}" range="{} {}"/>'.format
    return f"""
    <body>{capsule(x, y)}
      <body pos="{x} {y} 0">{hinge("hip", number, 0, 0, 1, -30, 30)}{capsule(x, y)}
        <body pos="{x} {y} 0">{hinge("ankle", number, *axis, *ankle_range)}{capsule(2 * x, 2 * y)}
        </body>
      </body>
    </body>"""


def model(timestep_s=TIMESTEP_S):
    """Returns the model of the ant on its floor."""
    legs = "".join(leg(number, *values) for number, values in enumerate(LEGS, start=1))
    motors = "".join(f'<motor joint="{joint}" gear="150" ctrlrange="-1 1"/>' for joint in MOTORS)
    return mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <compiler angle="degree"/>
  <option timestep="{timestep_s}" integrator="RK4"/>
  <default>
    <joint armature="1" damping="1" limited="true"/>
    <geom density="5" friction="1 0.5 0.5" margin="0.01" condim="3" conaffinity="0"
      solref="0.02 1" solimp="0.8 0.8 0.01"/>
    <motor ctrllimited="true"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="40 40 40" conaffinity="1"/>
    <body name="torso" pos="0 0 0.75">
      <joint type="free" armature="0" damping="0" limited="false"/>
      <geom type="sphere" size="0.25"/>{legs}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>""")


class Ant:
    """Episodes of the ant; observations and actions are laid out as in Goalward."""

    def __init__(self, timestep_s=TIMESTEP_S):
        self.model = model(timestep_s)
        self.data = mujoco.MjData(self.model)
        self.timesteps = round(STEP_S / timestep_s)
        self.marker = np.zeros(7)

    def begin(self, first):
        """Puts the ant into the state of the observation `first` and returns its own observation there."""
        mujoco.mj_resetData(self.model, self.data)
        self.marker = first[MARKER]
        self.data.qpos[:2] = first[GOAL_XY] - first[TO_GOAL]
        self.data.qpos[2:] = first[0:13]
        self.data.qvel[:] = first[20:34]
        return self.observation()

    def step(self, action):
        """Holds the torques for 0.1 s."""
        self.act(action)
        mujoco.mj_step(self.model, self.data, self.timesteps)
        return self.observation()

    def depth(self, observation):
        """Returns how deep the lowest ball or capsule of an observed ant is in the floor, meters."""
        self.begin(observation)
        mujoco.mj_kinematics(self.model, self.data)
        lowest = np.inf
        for geom in range(1, self.model.ngeom):
            radius, half_length, _ = self.model.geom_size[geom]
            tilt = abs(self.data.geom_xmat[geom][8])
            is_ball = self.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE
            reach = radius if is_ball else radius + half_length * tilt
            lowest = min(lowest, self.data.geom_xpos[geom][2] - reach)
        return max(0.0, -lowest)

    def act(self, action):
        self.data.ctrl[:] = np.clip(action, -1, 1)

    def observation(self):
        numbers = np.zeros(132)
        numbers[0:13] = self.data.qpos[2:]
        numbers[MARKER] = self.marker
        numbers[20:34] = self.data.qvel
        numbers[TO_GOAL] = self.marker[:2] - self.data.qpos[:2]
        return numbers


def torso_xy(observations):
    """Returns the x and y of the torso for observations in rows."""
    return observations[:, GOAL_XY] - observations[:, TO_GOAL]
