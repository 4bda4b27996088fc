"""The configuration of the insertion task; imports no torch and no Gymnasium."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.tasks.task import TaskConfig
from neurorobo.units import Duration, Unit
from precision_interaction import table_one


class InsertionTaskConfig(TaskConfig):
    """Insert the peg fully, fast, and with small radial forces (Eq. 3)."""

    implementation: ClassVar[str] = "precision_interaction.rig.insertion_task:InsertionTask"

    type: Literal["precision.insertion"] = "precision.insertion"
    tolerance: Annotated[float, Unit("um", gt=0)] = Field(
        default=1.0, description="An insertion is complete when no more than this is left."
    )
    time_limit: Annotated[Duration, Field(gt=0)] = Field(
        default=120_000_000_000, description="An insertion that takes as long has failed."
    )
    force_weight: Annotated[float, Unit("1", ge=0)] = Field(
        default=table_one.GAMMA_F, description="gamma_f: weight of the force against the distance left (Eq. 3, 13)."
    )
    distance_unit: Annotated[float, Unit("um", gt=0)] = Field(
        default=1000.0, description="The distance left counts in this unit; squared, in um it would drown the force."
    )
    force_unit: Annotated[float, Unit("mN", gt=0)] = Field(
        default=20.0, description="The radial force counts in this unit."
    )
