"""The configuration of the spiking prefrontal cortex: sizes and codes; imports no torch."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from neurorobo.clock import Clock
from neurorobo.codes import CoarseFine, PopulationNested, PopulationUniform
from neurorobo.regions import Port, RegionConfig
from neurorobo.units import Interval, Unit
from precision_interaction import table_one

Neurons = Annotated[int, Field(ge=1)]


class InputNeurons(BaseModel):
    """How many input neurons each component of each input has; 64 in all, as in the paper."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    force: Neurons = 4
    forecast: Neurons = 4
    variance: Neurons = 2
    remaining: Neurons = Field(default=4, description="Over the whole distance.")
    braking: Neurons = Field(default=18, description="Over the last part of the distance, beside those over the whole.")
    speed: Neurons = 18
    beta: Neurons = 4


class PrefrontalCortexConfig(RegionConfig):
    """The block-based feed-forward network that plans the axial speed (Sec. IV-D, Fig. 4).

    Two blocks of the second layer stand apart: one reads the forecast and its variance and learns C_p (Eq. 21-22), one
    reads the distance left and the speed and learns the terminal signal s_l (Eq. 26). The rest of the layer reads all.
    """

    implementation: ClassVar[str] = "precision_interaction.regions.prefrontal_cortex:PrefrontalCortex"
    pretrained_package: ClassVar[str | None] = "precision_interaction.weights"
    not_in_signature: ClassVar[frozenset[str]] = RegionConfig.not_in_signature | {
        "period",
        "start_speed",
        "beta_0",
    }

    type: Literal["precision.prefrontal_cortex"] = "precision.prefrontal_cortex"
    period: str = Field(default="control", description="Name of the period of the axial moves, as under `time`.")
    start_speed: Annotated[float, Unit("um/s", ge=0)] = Field(
        default=table_one.CREEP_SPEED_UM_S, description="The speed before anything is planned."
    )
    beta_0: Annotated[float, Unit("1", ge=0, le=1)] = Field(
        default=table_one.BETA_0, description="Beta at the start (Eq. 23)."
    )
    force_range: Annotated[Interval, Unit("mN")] = Interval(-100.0, 100.0)
    forecast_range: Annotated[Interval, Unit("mN")] = Interval(-60.0, 60.0)
    variance_range: Annotated[Interval, Unit("mN^2")] = Interval(0.0, 450.0)
    remaining_range: Annotated[Interval, Unit("um")] = Interval(0.0, table_one.LENGTH_UM)
    braking_range: Annotated[Interval, Unit("um")] = Field(
        default=Interval(0.0, 450.0),
        description="The part of the distance in which to brake; it has a finer code of its own.",
    )
    speed_range: Annotated[Interval, Unit("um/s")] = Field(
        default=Interval(0.0, table_one.MAX_SPEED_UM_S), description="Of the speed that is planned."
    )
    last_speed_range: Annotated[Interval, Unit("um/s")] = Field(
        default=Interval(0.0, 1.2 * table_one.MAX_SPEED_UM_S),
        description="Of the speed planned before. It reaches beyond: neurons that fire at every step are a constant "
        "current, and those that they drive fire always or never.",
    )
    last_beta_range: Annotated[Interval, Unit("1")] = Field(
        default=Interval(0.0, 1.25), description="Of the beta of before; it reaches beyond 1 for the same reason."
    )
    input_neurons: InputNeurons = InputNeurons()
    prediction_neurons: Neurons = Field(default=112, description="The block of the second layer that learns C_p.")
    terminal_neurons: Neurons = Field(default=48, description="The block of the second layer that learns s_l.")
    general_neurons: Neurons = Field(default=96, description="What is left of the second layer, 256 in all.")
    hidden_neurons: tuple[Neurons, ...] = Field(default=(512, 512, 128), description="The layers after the second.")
    output_neurons: Neurons = Field(default=2, description="Output neurons of the speed, and of beta.")

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Radial force now and n periods ahead, the n periods' variance, distance left, and what was planned before."""
        clock.seconds(self.period)  # a ConfigError if there is none of that name
        neurons = self.input_neurons
        remaining = CoarseFine.of(
            _nested(self.remaining_range, neurons.remaining), _nested(self.braking_range, neurons.braking)
        )
        force = _nested(self.force_range, neurons.force)
        forecast = _nested(self.forecast_range, neurons.forecast)
        variance = _nested(self.variance_range, neurons.variance)
        speed = _nested(self.last_speed_range, neurons.speed)
        beta = _nested(self.last_beta_range, neurons.beta)
        return {
            "force": Port("mN", 2, force, description="Radial force now."),
            "forecast": Port("mN", 2, forecast, description="Force expected n periods ahead, residual and contact."),
            "variance": Port("mN^2", 2, variance, description="Variance of n periods' contact, n times that of one."),
            "remaining": Port("um", 1, remaining, description="Axial distance left."),
            "speed": Port("um/s", 1, speed, (self.start_speed,), "Axial speed planned before."),
            "beta": Port("1", 1, beta, (self.beta_0,), "Confidence in past performance (Eq. 23)."),
        }

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """The planned axial speed and beta, and as numbers what the two blocks say."""
        planned = (self.speed_range, Interval(0.0, 1.0))
        speed, beta = (PopulationUniform(self.output_neurons, limits.lo, limits.hi) for limits in planned)
        return {
            "speed": Port("um/s", 1, speed, description="Planned axial speed."),
            "beta": Port("1", 1, beta, description="Confidence in past performance (Eq. 23)."),
            "confidence": Port("1", description="C_p: confidence in the forecast (Eq. 21-22)."),
            "terminal": Port("1", description="s_l: towards 1 when it is time to brake for the end (Eq. 26)."),
        }

    def signature(self, clock: Clock) -> Mapping[str, Any]:
        """Return what trained weights depend on: sizes, ranges and the length of the period, not its name."""
        return {**super().signature(clock), "period_s": clock.seconds(self.period)}


def _nested(limits: Interval, neurons: int) -> PopulationNested:
    return PopulationNested(neurons, limits.lo, limits.hi)
