"""The configurations of neurons of two variables; they import no torch."""

from abc import ABC, abstractmethod
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from neurorobo.neurons.bidimensional import MOST_SUBSTEPS, AdEx, Izhikevich
from neurorobo.neurons.config import NeuronConfig, SurrogateConfig, TimeConstant
from neurorobo.neurons.exponential import MOST
from neurorobo.units import Unit, format_duration

LONGEST_STEP_NS = 2_000_000
"""Within the fastest published bursts, spikes are 2.5 to 3 ms apart, and a neuron fires at most once a step."""

Regime = Literal[
    "regular_spiking",
    "intrinsically_bursting",
    "chattering",
    "fast_spiking",
    "low_threshold_spiking",
    "thalamo_cortical",
    "resonator",
]

REGIMES: dict[str, dict[str, float | str]] = {
    "regular_spiking": {"a": 0.02, "b": 0.2, "c": "-65 mV", "d": 8.0},
    "intrinsically_bursting": {"a": 0.02, "b": 0.2, "c": "-55 mV", "d": 4.0},
    "chattering": {"a": 0.02, "b": 0.2, "c": "-50 mV", "d": 2.0},
    "fast_spiking": {"a": 0.1, "b": 0.2, "c": "-65 mV", "d": 2.0},
    "low_threshold_spiking": {"a": 0.02, "b": 0.25, "c": "-65 mV", "d": 2.0},
    "thalamo_cortical": {"a": 0.02, "b": 0.25, "c": "-65 mV", "d": 0.05},
    "resonator": {"a": 0.1, "b": 0.26, "c": "-65 mV", "d": 2.0},
}
"""The values that are published for each, by name. Source: Izhikevich 2003, Fig. 2."""


class _Substepped(NeuronConfig, ABC):
    """A neuron whose equations are integrated in equal parts of a step."""

    def substeps(self, step_ns: int) -> int:
        """Return how many substeps a step has: as few as are not longer than the longest."""
        return -(-step_ns // self._longest_ns())

    def check(self, step_ns: int) -> None:
        """Raise a ValueError for steps that are too long for a neuron that fires once, and for too many substeps."""
        if step_ns > LONGEST_STEP_NS:
            raise ValueError(
                f"a neuron fires at most once in a spike step, and `{self.type}` may want to after "
                f"{format_duration(LONGEST_STEP_NS)}; let `time.spike_step` be no longer (it is "
                f"{format_duration(step_ns)}), or take a simpler neuron"
            )
        if (parts := self.substeps(step_ns)) > MOST_SUBSTEPS:
            raise ValueError(
                f"`longest_substep` makes {parts} substeps of a spike step of {format_duration(step_ns)}, more than "
                f"{MOST_SUBSTEPS}; lengthen it, or shorten `time.spike_step`"
            )

    @abstractmethod
    def _longest_ns(self) -> int:
        """Return the longest substep."""


class IzhikevichConfig(_Substepped):
    """Izhikevich's simple model of spiking neurons (Izhikevich 2003)."""

    most_substep_ns: ClassVar[int] = 500_000

    type: Literal["izhikevich"] = "izhikevich"
    regime: Regime = Field(
        default="regular_spiking",
        description="The published `a`, `b`, `c` and `d`, of which any can be changed.",
    )
    a: float = Field(default=0.02, gt=0, description="How fast the recovery variable is, per ms.")
    b: float = Field(default=0.2, description="How much of the potential the recovery variable follows.")
    c: Annotated[float, Unit("mV", lt=30.0)] = Field(default=-65.0, description="The potential after a spike.")
    d: float = Field(default=8.0, description="What a spike adds to the recovery variable.")
    input_gain: float = Field(
        default=40.0, gt=0, description="The current `I` of the published equations that is an input of one."
    )
    longest_substep: TimeConstant = Field(
        default=250_000, description="The longest step of the integration, of which a spike step has one or more."
    )
    surrogate: SurrogateConfig = SurrogateConfig(shape="fast_sigmoid", width=20.0)

    @model_validator(mode="before")
    @classmethod
    def _published(cls, values: object) -> object:
        if not isinstance(values, dict) or not isinstance(regime := values.get("regime"), str):
            return values
        return {**REGIMES.get(regime, {}), **values}

    def check(self, step_ns: int) -> None:
        """Raise a ValueError for steps that are too long or too many; see the ranges in the documentation."""
        super().check(step_ns)
        substep_ns = step_ns / self.substeps(step_ns)
        if substep_ns > self.most_substep_ns:
            raise ValueError(
                f"at substeps of {substep_ns / 1e6:g} ms, a potential below {-62.5 - 12.5e6 / substep_ns:g} mV "
                f"overshoots where it aims; let `longest_substep` be at most {format_duration(self.most_substep_ns)}"
            )
        if self.a * substep_ns > 1e6:
            raise ValueError(
                f"at substeps of {substep_ns / 1e6:g} ms, a recovery variable with `a: {self.a:g}` overshoots what it "
                f"follows; let `longest_substep` be at most {1 / self.a:g} ms"
            )

    def build(self, step_ns: int) -> Izhikevich:
        """Return the neuron at a step."""
        return Izhikevich(
            a=self.a,
            b=self.b,
            c=self.c,
            d=self.d,
            input_gain=self.input_gain,
            step_ms=step_ns / 1e6,
            substeps=self.substeps(step_ns),
            surrogate=self.surrogate.build(),
        )

    def _longest_ns(self) -> int:
        return self.longest_substep


class AdExConfig(_Substepped):
    """The adaptive exponential integrate-and-fire neuron; the defaults are the cell of Brette & Gerstner 2005."""

    type: Literal["adex"] = "adex"
    capacitance: Annotated[float, Unit("pF", gt=0)] = 281.0
    leak_conductance: Annotated[float, Unit("nS", gt=0)] = 30.0
    resting_potential: Annotated[float, Unit("mV")] = Field(default=-70.6, description="Of the leak.")
    slope_factor: Annotated[float, Unit("mV", gt=0)] = Field(
        default=2.0, description="How sharply the upstroke begins; its current grows e-fold with each."
    )
    threshold: Annotated[float, Unit("mV")] = Field(default=-50.4, description="Where the upstroke begins.")
    adaptation_time_constant: TimeConstant = 144_000_000
    a: Annotated[float, Unit("nS")] = Field(
        default=4.0, description="The adaptation below the threshold: its current for each mV above rest."
    )
    b: Annotated[float, Unit("pA")] = Field(default=80.5, description="What a spike adds to the adaptation current.")
    reset_potential: Annotated[float, Unit("mV")] = Field(default=-70.6, description="The potential after a spike.")
    peak_potential: Annotated[float, Unit("mV")] | None = Field(
        default=None, description="Where an upstroke ends in a spike; ten slope factors above threshold if left out."
    )
    input_gain: Annotated[float, Unit("pA", gt=0)] = Field(
        default=10_000.0, description="The current that is an input of one."
    )
    longest_substep: TimeConstant = Field(
        default=100_000, description="The longest step of the integration, of which a spike step has one or more."
    )
    surrogate: SurrogateConfig = SurrogateConfig(shape="fast_sigmoid", width=5.0)

    @model_validator(mode="after")
    def _upstroke_ends(self) -> Self:
        peak = self.peak_mV
        if not self.threshold < peak:
            raise ValueError(f"`peak_potential` lies above the `threshold` of {self.threshold:g} mV, got {peak:g} mV")
        if not self.reset_potential < peak:
            raise ValueError(
                f"`reset_potential` lies below the peak potential of {peak:g} mV, got {self.reset_potential:g} mV"
            )
        if (peak - self.threshold) / self.slope_factor > MOST:
            raise ValueError(
                f"`peak_potential` lies at most {MOST:.0f} slope factors above the `threshold`, or its current is no "
                f"number any more; got {peak:g} mV, and 10 of them are usual"
            )
        return self

    @property
    def peak_mV(self) -> float:
        """Where an upstroke ends."""
        return self.threshold + 10 * self.slope_factor if self.peak_potential is None else self.peak_potential

    def check(self, step_ns: int) -> None:
        """Raise a ValueError for steps that are too long or too many; see the ranges in the documentation."""
        super().check(step_ns)
        substep_ns = step_ns / self.substeps(step_ns)
        membrane = self.capacitance / self.leak_conductance * 1e6 / substep_ns
        adaptation = self.adaptation_time_constant / substep_ns
        if membrane < 1:
            why = f"a membrane of {self.capacitance / self.leak_conductance:g} ms overshoots its resting potential"
        elif adaptation < 1:
            why = f"an adaptation of {format_duration(self.adaptation_time_constant)} overshoots what it follows"
        elif (2 * membrane - 1) * (2 * adaptation - 1) <= self.a / self.leak_conductance:
            why = f"membrane and adaptation throw each other from side to side with `a: {self.a:g} nS`"
        else:
            return
        raise ValueError(f"at substeps of {substep_ns / 1e6:g} ms, {why}; shorten `longest_substep`")

    def build(self, step_ns: int) -> AdEx:
        """Return the neuron at a step."""
        return AdEx(
            capacitance_pF=self.capacitance,
            leak_nS=self.leak_conductance,
            rest_mV=self.resting_potential,
            slope_mV=self.slope_factor,
            threshold_mV=self.threshold,
            time_constant_ms=self.adaptation_time_constant / 1e6,
            a_nS=self.a,
            b_pA=self.b,
            reset_mV=self.reset_potential,
            input_gain=self.input_gain,
            peak_mV=self.peak_mV,
            step_ms=step_ns / 1e6,
            substeps=self.substeps(step_ns),
            surrogate=self.surrogate.build(),
        )

    def _longest_ns(self) -> int:
        return self.longest_substep
