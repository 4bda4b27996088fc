"""Peg and hole as a MuJoCo model: a tool that gives way, and a hole of rings that give way.

Lengths are in um, forces in mN, times in s, so that mass counts in mN s^2/um, which is 1000 kg. In SI, displacements of
1e-8 m beside a peg of 2e-3 m would be near MuJoCo's least values; here they are 0.01 beside 2000.
"""

import math
from collections.abc import Mapping
from copy import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies.body import Array
from neurorobo.errors import NeuroroboError
from precision_interaction.rig.mujoco_rig_config import BEAD_RADIUS_UM, LONGEST_STEP_NS, MujocoRigConfig

PEG_RADIUS_UM = 2000.0
LAND_UM = 5.0
"""Length of the peg's tip that is as wide as the peg; behind it, the shaft is relieved and touches nothing."""

SEGMENTS: Mapping[str, NDArray[np.float64]] = {
    "right": np.array([1.0, 0.0]),
    "left": np.array([-1.0, 0.0]),
    "far": np.array([0.0, 1.0]),
    "near": np.array([0.0, -1.0]),
}
"""The four segments of a ring, and the direction in which each slides."""

# Motions are so slow that inertia plays no part; mass and damping only let forces settle within a few steps.
MASS = 0.004
DAMPING_RATIO = 0.4
DRIVEN_MASS = 1e6  # of stage and elevator: what drives them, no force of this rig slows down
AXIAL_TOOL_STIFFNESS_MN_UM = 300.0

# Contacts are as hard as they can be with friction and without chatter: with these masses, impedance and time constant
# make them springs of 300 mN/um.
CONTACT_IMPEDANCE = 0.9
CONTACT_S = 2e-9 * LONGEST_STEP_NS

SLIDE = mujoco.mjtJoint.mjJNT_SLIDE
DRIVEN = ("stage_x", "stage_y", "elevator")


class PegAndHole:
    """One peg and one hole, whose rings are drawn from ``seed``; it can be moved forward alone.

    Rings further from the peg's land than a segment can reach are at rest and touch nothing. So only those near it are
    simulated: one that the land has left takes the place of the next one ahead.
    """

    def __init__(self, config: MujocoRigConfig, model: mujoco.MjModel, seed: int) -> None:
        """Take a model of `build`; of it, this one gets a copy."""
        self._config = config
        self.model = copy(model)
        self.data = mujoco.MjData(self.model)
        self.depth_um, self.centre_um = draw_rings(config, np.random.default_rng(seed))
        names = [[f"{name}_{slot}" for name in SEGMENTS] for slot in range(simulated_rings(config))]
        self._bodies = np.array([[self.model.body(name).id for name in ring] for ring in names])
        # All joints slide, so that the address of a position is that of its velocity.
        self._joints = np.array([[self.model.joint(name).qposadr[0] for name in ring] for ring in names])
        self._driven = np.array([self.model.joint(name).qposadr[0] for name in DRIVEN])
        self._first = 0  # the shallowest ring that is simulated
        for ring in range(len(self._bodies)):
            self._place(ring)
        mujoco.mj_forward(self.model, self.data)

    def move(self, travel_um: float, stage_um: Array, duration_ns: int) -> Array:
        """Move elevator and stage (2,) evenly to these positions, and return the force (3,) of the hole on the peg.

        The duration is a multiple of the time step. Raises a NeuroroboError if the simulation becomes unstable.
        """
        target_um = np.array([*stage_um, travel_um])
        velocity_um_s = (target_um - self.data.qpos[self._driven]) / (duration_ns * 1e-9)
        left = duration_ns // self._config.time_step
        advance_um = max(velocity_um_s[2], 0.0) * self._config.time_step * 1e-9
        most = left if advance_um == 0 else max(1, int(self._config.ring_pitch / advance_um))
        while left:
            self._exchange_rings()
            self.data.qvel[self._driven] = velocity_um_s
            steps = min(left, most)
            mujoco.mj_step(self.model, self.data, nstep=steps)
            left -= steps
        self.data.qpos[self._driven], self.data.qvel[self._driven] = target_um, velocity_um_s
        mujoco.mj_forward(self.model, self.data)
        if self.data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(self.data.sensordata).all():
            raise NeuroroboError("body: MuJoCo's simulation became unstable; take a smaller `body.time_step`")
        return -np.asarray(self.data.sensordata)  # the sensor's is that of the peg on the tool's base

    def _exchange_rings(self) -> None:
        """Put rings that the land has left ahead of it, up to the last ring of the hole."""
        inside_um = self.data.qpos[self._driven[2]] - self._config.gap
        passed_um = inside_um - LAND_UM - BEAD_RADIUS_UM
        last = len(self.depth_um) - len(self._bodies)
        while self._first < last and self.depth_um[self._first] < passed_um:
            self._place(self._first + len(self._bodies))
            self._first += 1

    def _place(self, ring: int) -> None:
        """Put a ring, relaxed, where it belongs on the elevator."""
        slot = ring % len(self._bodies)
        reach_um = PEG_RADIUS_UM + BEAD_RADIUS_UM - self._config.interference
        for body, direction in zip(self._bodies[slot], SEGMENTS.values(), strict=True):
            self.model.body_pos[body, :2] = self.centre_um[ring] + reach_um * direction
            self.model.body_pos[body, 2] = -self._config.gap - self.depth_um[ring]
        self.data.qpos[self._joints[slot]] = 0.0
        self.data.qvel[self._joints[slot]] = 0.0


def draw_rings(config: MujocoRigConfig, generator: np.random.Generator) -> tuple[Array, Array]:
    """Return depth (rings,) and centre (rings, 2) of every ring, in um.

    The centres lie on the tilted axis of the hole, plus a random walk.
    """
    rings = math.ceil(config.length / config.ring_pitch) + simulated_rings(config)
    inside_um = (np.arange(rings) + generator.random(rings)) * config.ring_pitch
    apart_um = np.diff(inside_um, prepend=0.0)
    deviation_um = np.sqrt(apart_um / 1000.0)[:, None] * np.asarray(config.wander)
    strayed_um = np.cumsum(deviation_um * generator.standard_normal((rings, 2)), axis=0)
    centre_um = inside_um[:, None] * 1e-3 * np.asarray(config.tilt) + strayed_um
    # A segment touches the edge of the land before its middle is level with it.
    early_um = math.sqrt(2.0 * BEAD_RADIUS_UM * config.interference - config.interference**2)
    return inside_um + early_um, centre_um


def simulated_rings(config: MujocoRigConfig) -> int:
    """Return how many rings there may be near the land, one being exchanged."""
    return math.ceil((LAND_UM + 2.0 * BEAD_RADIUS_UM) / config.ring_pitch) + 2


def build(config: MujocoRigConfig) -> mujoco.MjModel:
    """Return the model, its rings still to be placed.

    The stage carries the peg on springs (the tool), with the force sensor between the two; the elevator carries the
    segments of the rings, each on a spring and a damper along its radius.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = config.time_step * 1e-9
    spec.option.gravity = np.zeros(3)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET
    surface = {
        "condim": 3,
        "friction": [config.friction, 0.0, 0.0],
        "solref": [CONTACT_S, 1.0],
        "solimp": [CONTACT_IMPEDANCE, CONTACT_IMPEDANCE, 1.0, 0.5, 1.0],
    }
    stage = _body(spec.worldbody, "stage", DRIVEN_MASS)
    stage.add_joint(name="stage_x", type=SLIDE, axis=[1, 0, 0])
    stage.add_joint(name="stage_y", type=SLIDE, axis=[0, 1, 0])
    peg = _body(stage, "peg", MASS)
    for axis, stiffness in zip(np.eye(3), (*[config.tool_stiffness] * 2, AXIAL_TOOL_STIFFNESS_MN_UM), strict=True):
        _spring(peg, f"tool_{'xyz'[int(axis.argmax())]}", axis, stiffness)
    peg.add_geom(
        name="land",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[PEG_RADIUS_UM, LAND_UM / 2, 0],
        pos=[0, 0, LAND_UM / 2],
        contype=1,
        conaffinity=0,
        **surface,
    )
    peg.add_site(name="tool")
    spec.add_sensor(name="force", type=mujoco.mjtSensor.mjSENS_FORCE, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="tool")
    elevator = _body(spec.worldbody, "elevator", DRIVEN_MASS)
    elevator.add_joint(name="elevator", type=SLIDE, axis=[0, 0, 1])
    for slot in range(simulated_rings(config)):
        for name, direction in SEGMENTS.items():
            segment = _body(elevator, f"{name}_{slot}", MASS)
            _spring(segment, f"{name}_{slot}", np.append(direction, 0.0), config.segment_stiffness)
            segment.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[BEAD_RADIUS_UM, 0, 0], contype=0, conaffinity=1, **surface
            )
    return spec.compile()


def _body(parent: mujoco.MjsBody, name: str, mass: float) -> mujoco.MjsBody:
    """Add a body that only slides, so that its inertia does not matter."""
    return parent.add_body(
        name=name, mass=mass, ipos=[0, 0, 0], inertia=[mass * PEG_RADIUS_UM**2] * 3, explicitinertial=True
    )


def _spring(body: mujoco.MjsBody, name: str, axis: Array, stiffness_mN_um: float) -> None:
    damping = 2.0 * DAMPING_RATIO * math.sqrt(stiffness_mN_um * MASS)
    body.add_joint(name=name, type=SLIDE, axis=axis, stiffness=stiffness_mN_um, damping=damping)
