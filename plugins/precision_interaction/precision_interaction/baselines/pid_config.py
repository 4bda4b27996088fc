"""The configuration of the PID controller; imports no torch."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.units import Unit
from precision_interaction.teachers.analytic_config import Acceleration
from precision_interaction.teachers.compensators_config import CompensatorConfig

Gain = Annotated[float, Unit("1", ge=0)]


class PidConfig(CompensatorConfig):
    """A PID controller of the radial force, without any expectation.

    The move is (kp e + ki sum(e) + kd (e - e')) / M, where e is the force and e' the force before; gains are per
    period. The defaults are the PI controller of the paper's ref. [3]; kp: 1 and ki: 0 make the compensation of its
    ref. [7].
    """

    implementation: ClassVar[str] = "precision_interaction.baselines.pid:PidCompensator"
    expectation_optional: ClassVar[bool] = True

    type: Literal["precision.pid"] = "precision.pid"
    carry: Literal["never", "repeat", "always"] = "always"
    kp: Gain = 0.5
    ki: Gain = 0.3
    kd: Gain = 0.0
    max_acceleration: Acceleration | None = Field(
        default=None, description="Largest radial acceleration, both axes together; without one if left out."
    )
