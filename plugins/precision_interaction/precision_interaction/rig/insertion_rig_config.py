"""The configuration of the simulated insertion rig and of its contact; imports no torch and builds nothing."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from neurorobo.units import Unit
from precision_interaction import table_one
from precision_interaction.rig.insertion_body_config import InsertionBodyConfig

Slope = Annotated[float, Unit("mN/um")]
VarianceSlope = Annotated[float, Unit("mN^2/um", ge=0)]
Force = Annotated[float, Unit("mN")]
ForceVariance = Annotated[float, Unit("mN^2", ge=0)]
Coefficient = Annotated[float, Unit("1", gt=-1, lt=1)]
Forces = tuple[Force, Force, Force]
Variances = tuple[ForceVariance, ForceVariance, ForceVariance]


class _Options(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Correlation(_Options):
    """Correlation coefficients of the contact force's axes: the full matrix of Eq. 1."""

    xy: Coefficient = 0.0
    xz: Coefficient = 0.0
    yz: Coefficient = 0.0

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if 1 + 2 * self.xy * self.xz * self.yz <= self.xy**2 + self.xz**2 + self.yz**2:
            raise ValueError("no three quantities can be correlated like this; bring the coefficients closer to 0")
        return self


class _GaussianContact(_Options):
    depth_gain: Annotated[float, Unit("1", ge=0)] = Field(
        default=0.0, description="g: a contact increment at depth d is scaled by 1 + g d / length."
    )
    correlation: Correlation = Correlation()


class ProportionalContactConfig(_GaussianContact):
    """Mean and variance proportional to the inserted distance, the only law for which Eq. 8 and 35 hold."""

    law: Literal["proportional"]
    mean_slope: tuple[Slope, Slope, Slope] = (*table_one.PROPORTIONAL_MEAN_MN_UM, 0.0)
    variance_slope: tuple[VarianceSlope, VarianceSlope, VarianceSlope] = (*table_one.PROPORTIONAL_VARIANCE_MN2_UM, 0.0)


class MeasuredContactConfig(_GaussianContact):
    """The line through the published points, its intercept once per axial move: the rig as it was measured."""

    law: Literal["measured"] = "measured"
    mean_slope: tuple[Slope, Slope, Slope] = (*table_one.MEASURED_MEAN_SLOPE_MN_UM, 0.0)
    mean_intercept: Forces = (*table_one.MEASURED_MEAN_INTERCEPT_MN, 0.0)
    variance_slope: tuple[VarianceSlope, VarianceSlope, VarianceSlope] = (
        *table_one.MEASURED_VARIANCE_SLOPE_MN2_UM,
        0.0,
    )
    variance_intercept: Variances = (*table_one.MEASURED_VARIANCE_INTERCEPT_MN2, 0.0)


class TablePoint(_Options):
    """Mean and variance (x, y, z) of the force that one axial move of this distance adds."""

    distance: Annotated[float, Unit("um", gt=0)]
    mean: Forces
    variance: Variances


class TableContactConfig(_GaussianContact):
    """Measured points of any law, joined by straight lines from (0, 0) on."""

    law: Literal["table"]
    points: tuple[TablePoint, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _rising(self) -> Self:
        for before, after in zip(self.points, self.points[1:], strict=False):
            if before.distance >= after.distance:
                raise ValueError(f"distances must rise; {after.distance:g} um comes after {before.distance:g} um")
            if any(low > high for low, high in zip(before.variance, after.variance, strict=True)):
                raise ValueError(f"the variance falls at {after.distance:g} um; make it rise with distance")
        return self


class RecordedContactConfig(_Options):
    """A recorded insertion, replayed: contact force over depth, the same in every episode."""

    law: Literal["recorded"]
    file: str = Field(
        description="CSV: depth_um (0 at first contact), force_x_mN, force_y_mN and, if recorded, force_z_mN. A "
        "relative path starts at the working directory of the run, not at the experiment file."
    )


ContactConfig = Annotated[
    ProportionalContactConfig | MeasuredContactConfig | TableContactConfig | RecordedContactConfig,
    Field(discriminator="law"),
]


class StiffnessChange(_Options):
    """Another stiffness from some travel on, as when the peg is held anew or the hole's part comes loose."""

    at: Annotated[float, Unit("um", ge=0)] = Field(description="Axial travel, the gap included, where it changes.")
    to: Annotated[float, Unit("mN/um", gt=0)] = Field(description="M from there on.")


class InsertionRigConfig(InsertionBodyConfig):
    """The insertion body whose contact force is drawn from a law (Eq. 1-2)."""

    implementation: ClassVar[str] = "precision_interaction.rig.insertion_rig:InsertionRig"

    type: Literal["precision.insertion_rig"] = "precision.insertion_rig"
    contact: ContactConfig = MeasuredContactConfig()
    stiffness: Annotated[float, Unit("mN/um", gt=0)] = Field(
        default=table_one.STIFFNESS_MN_UM, description="M: what a radial move of 1 um takes off the radial force."
    )
    stiffness_change: StiffnessChange | None = Field(
        default=None,
        exclude_if=lambda change: change is None,
        description="Another stiffness from some travel on.",
    )
