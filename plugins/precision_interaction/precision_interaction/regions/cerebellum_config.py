"""The configuration of the spiking cerebellum: sizes and codes; imports no torch."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.codes import PopulationUniform
from neurorobo.regions import Port, RegionConfig
from neurorobo.units import Interval, Unit

Velocities = Annotated[Interval, Unit("um/s")]
Forces = Annotated[Interval, Unit("mN")]
Variances = Annotated[Interval, Unit("mN^2")]
Moves = Annotated[Interval, Unit("um")]

PORTS = ("force", "velocity", "mean", "variance", "move", "residual")


class CerebellumConfig(RegionConfig):
    """Mossy fibres, granule cells, Purkinje cells, deep nuclei: radial force and expected contact -> radial move.

    Source: Sec. III-C of Xing et al. Ranges are per radial period, and a narrower one is a finer code; those left out
    follow from the length of the period (:func:`default_ranges`).
    """

    implementation: ClassVar[str] = "precision_interaction.regions.cerebellum:Cerebellum"
    pretrained_package: ClassVar[str | None] = "precision_interaction.weights"

    type: Literal["precision.cerebellum"] = "precision.cerebellum"
    period: str = Field(default="radial", description="Name of the period of the radial moves, as under `time`.")
    mossy_fibres: int = Field(default=8, ge=1, description="Mossy fibres per component of an input.")
    granule_cells: int = Field(default=4000, ge=1)
    granule_fan_in: int = Field(default=4, ge=1, description="Mossy fibres that each granule cell reads.")
    purkinje_cells: int = Field(default=1600, ge=1)
    nuclei: int = Field(
        default=8, ge=4, multiple_of=4, description="Deep nuclear cells, as many for each output component."
    )
    output_neurons: int = Field(default=10, ge=1, description="Output neurons per component of an output.")
    own_velocity: bool = Field(
        default=False,
        description="Whether the velocity has output neurons of its own, to be taught by name; by default it is the "
        "move per period, which the velocity of `precision.profile` is not.",
    )
    force: Forces | None = Field(default=None, description="Range of the radial force.")
    velocity: Velocities | None = Field(default=None, description="Range of the radial velocity that is told.")
    mean: Forces | None = Field(default=None, description="Range of the expected change of the force.")
    variance: Variances | None = Field(default=None, description="Range of its variance.")
    move: Moves | None = Field(default=None, description="Range of the radial move.")
    residual: Forces | None = Field(default=None, description="Range of the force left after the move.")

    def period_s(self, clock: Clock) -> float:
        """Return the length of the radial period; a ConfigError if the clock has none of that name."""
        return clock.seconds(self.period)

    def ranges(self, clock: Clock) -> dict[str, Interval]:
        """Return the range of each port, in its unit."""
        default = default_ranges(self.period_s(clock))
        return {name: getattr(self, name) or default[name] for name in PORTS}

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Radial force, radial velocity of the period before, and mean and variance of the contact to come."""
        code = {name: PopulationUniform(self.mossy_fibres, r.lo, r.hi) for name, r in self.ranges(clock).items()}
        return {
            "force": Port("mN", 2, code["force"], description="Radial force."),
            "velocity": Port(
                "um/s", 2, code["velocity"], (0.0, 0.0), description="Radial velocity of the period before."
            ),
            "mean": Port("mN", 2, code["mean"], description="Expected change of the force in this period."),
            "variance": Port("mN^2", 2, code["variance"], description="Its variance."),
        }

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """The radial move, the force left after it (Eq. 19), and the velocity: the move per period, or its own."""
        period_s = self.period_s(clock)
        ranges = self.ranges(clock)
        move, residual = ranges["move"], ranges["residual"]
        n = self.output_neurons
        if self.own_velocity:
            velocity, meaning = ranges["velocity"], "Radial velocity at the period's end."
        else:
            velocity = Interval(move.lo / period_s, move.hi / period_s)
            meaning = "Mean radial velocity of the period: the spikes of the move, read by its duration."
        return {
            "move": Port(
                "um",
                2,
                PopulationUniform(n, move.lo, move.hi),
                description="Radial move; a positive one lowers the force.",
            ),
            "residual": Port(
                "mN",
                2,
                PopulationUniform(n, residual.lo, residual.hi),
                description="Force left after the move, without the contact of the period.",
            ),
            "velocity": Port(
                "um/s",
                2,
                PopulationUniform(n, velocity.lo, velocity.hi),
                description=meaning,
            ),
        }

    def signature(self, clock: Clock) -> Mapping[str, Any]:
        """Return what trained weights depend on: sizes, ranges and the length of the period, not its name."""
        sizes = ("mossy_fibres", "granule_cells", "granule_fan_in", "purkinje_cells", "nuclei", "output_neurons")
        return {
            "type": self.type,
            "window": clock.window,
            "period_s": self.period_s(clock),
            **{name: getattr(self, name) for name in sizes},
            **{name: [r.lo, r.hi] for name, r in self.ranges(clock).items()},
            **({"own_velocity": True} if self.own_velocity else {}),
        }


def default_ranges(period_s: float) -> dict[str, Interval]:
    """Return the ranges that fit a radial period, in the units of the ports.

    In one period the contact at 100 um/s adds up to 107 mN/s. A short period takes off little force at once, so its
    moves need a narrow range, and more of the force may be left for the next one.
    """
    move = Interval(-0.1 - 0.7 * period_s, 0.1 + 2.15 * period_s)
    return {
        "force": Interval(-60.0 - 70.0 * period_s, 60.0 + 70.0 * period_s),
        "velocity": Interval(move.lo / period_s, move.hi / period_s),
        "mean": Interval(0.0, 120.0 * period_s),
        "variance": Interval(0.0, 140.0 * period_s),
        "move": move,
        "residual": Interval(-25.0 - 95.0 * period_s, 25.0 / (1.0 + 2.0 * period_s)),
    }
