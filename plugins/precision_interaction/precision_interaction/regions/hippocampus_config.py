"""The configuration of the spiking hippocampus: sizes and codes; imports no torch."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.codes import PopulationUniform
from neurorobo.regions import Port, RegionConfig
from neurorobo.units import Interval, Unit
from precision_interaction import table_one


class HippocampusConfig(RegionConfig):
    """The double-recurrent network that expects the coming contact: speed -> mean, variance (Sec. IV-B, Eq. 1, 8, 35).

    Inside, spiking neural units excite one another; outside, the outputs of one window feed the next, each use looking
    one period further ahead. The law is that of one radial period: the ranges of its codes scale with the period, the
    spikes stay the same.
    """

    implementation: ClassVar[str] = "precision_interaction.regions.hippocampus:Hippocampus"
    pretrained_package: ClassVar[str | None] = "precision_interaction.weights"
    not_in_signature: ClassVar[frozenset[str]] = RegionConfig.not_in_signature | {
        "period",
        "start_speed",
        "surrogate_width",
    }

    type: Literal["precision.hippocampus"] = "precision.hippocampus"
    carry: Literal["never", "repeat", "always"] = "repeat"
    period: str = Field(default="radial", description="Name of the period whose contact is expected, as under `time`.")
    outer: bool = Field(
        default=True, description="Whether the outputs of one window feed the next (the outer recurrence)."
    )
    recurrence: Literal["trained", "fixed", "none"] = Field(
        default="trained",
        exclude_if=lambda recurrence: recurrence == "trained",  # the hashes of what was trained before stay the same
        description="The synapses of the hidden neurons among themselves (the inner recurrence): trained; drawn once "
        "and left as they are, thresholds too, as in a liquid state machine; or none.",
    )
    surrogate_width: float = Field(
        default=1.0,
        gt=0,
        exclude_if=lambda width: width == 1.0,
        description="The width of the surrogate derivative, in units of the potential; it acts in training only.",
    )
    start_speed: Annotated[float, Unit("um/s", ge=0)] = Field(
        default=table_one.CREEP_SPEED_UM_S, description="The speed before anything is planned."
    )
    speed_range: Annotated[Interval, Unit("um/s")] = Field(
        default=Interval(0.0, table_one.MAX_SPEED_UM_S), description="Range of the speed's code."
    )
    mean_range: Annotated[Interval, Unit("mN")] = Field(
        default=Interval(0.0, 360.0),
        description="Range of the mean's code at a period of 1 s, up to the furthest look ahead.",
    )
    variance_range: Annotated[Interval, Unit("mN^2")] = Field(
        default=Interval(0.0, 360.0), description="Range of the variance's code at a period of 1 s, likewise."
    )
    speed_neurons: int = Field(default=50, ge=1)
    hidden_neurons: int = Field(default=343, ge=1)
    output_neurons: int = Field(default=10, ge=1, description="Output neurons of each of the four parameters.")

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Axial speed, and the expectation of the window before in the code of the outputs."""
        speed = PopulationUniform(self.speed_neurons, self.speed_range.lo, self.speed_range.hi)
        ports = {"speed": Port("um/s", 1, speed, (self.start_speed,), "Axial speed of the period.")}
        if self.outer:
            mean, variance = self._codes(clock)
            ports["mean_feedback"] = Port("mN", 2, mean, (0.0, 0.0), "Mean up to the period before.")
            ports["variance_feedback"] = Port("mN^2", 2, variance, (0.0, 0.0), "Variance up to the period before.")
        return ports

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Mean and variance of the force that the contact adds up to this period."""
        mean, variance = self._codes(clock)
        return {
            "mean": Port("mN", 2, mean, description="Expected change of the radial force."),
            "variance": Port("mN^2", 2, variance, description="Its variance."),
        }

    def _codes(self, clock: Clock) -> tuple[PopulationUniform, PopulationUniform]:
        scale = clock.seconds(self.period)
        mean, variance = (
            PopulationUniform(self.output_neurons, limits.lo * scale, limits.hi * scale)
            for limits in (self.mean_range, self.variance_range)
        )
        return mean, variance
