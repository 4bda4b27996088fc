"""The identification experiment on a simulated body: insert, withdraw, and again (Sec. VI-B)."""

from collections.abc import Sequence

import numpy as np

from neurorobo.plugins.imports import import_target
from precision_interaction.identification.log import Array, ContactLog
from precision_interaction.rig.insertion_body import InsertionBody
from precision_interaction.rig.insertion_body_config import InsertionBodyConfig

STEPS_UM = (2.0, 5.0, 10.0, 20.0, 30.0, 40.0, 50.0)
REPETITIONS = 400


def insert_and_withdraw(
    config: InsertionBodyConfig,
    *,
    steps_um: Sequence[float] = STEPS_UM,
    repetitions: int = REPETITIONS,
    seed: int = 0,
    depth_um: float = 0.0,
) -> ContactLog:
    """Log what the force sensor reads before and after one axial move of each step, from ``depth_um`` inside the hole.

    There, if inside at all, the body first stands still for one axial period, so that the force has settled.
    Every repetition is a body of its own, as after a withdrawal; nothing moves radially.
    """
    approach = (depth_um, 0.0) if depth_um > 0 else (0.0,)
    forces = [
        reach(config.model_copy(update={"gap": 0.0}), (*approach, step), repetitions, (seed, number))
        for number, step in enumerate(steps_um)
    ]
    increment_mN = np.concatenate([force[-1] - force[-2] for force in forces])
    return ContactLog(np.repeat(np.asarray(steps_um, dtype=np.float64), repetitions), increment_mN, "simulated body")


def reach(
    config: InsertionBodyConfig,
    moves_um: Sequence[float],
    repetitions: int,
    seed: Sequence[int],
    *,
    parts: int = 1,
) -> list[Array]:
    """Return the radial force (repetitions, 2), mN, that is read at first and after each of several axial moves.

    With ``parts``, after each of so many equal parts of each move.
    """
    body: InsertionBody = import_target(config.implementation)(config)
    body.reset([int(state) for state in np.random.SeedSequence(seed).generate_state(repetitions, np.uint64)])
    forces = [body.read()["force"]]
    for move_um in moves_um:
        speed = np.full((repetitions, 1), move_um / (config.axial_period * 1e-9))
        for _ in range(parts):
            body.advance({"axial_speed": speed}, config.axial_period // parts)
            forces.append(body.read()["force"])
    return forces
