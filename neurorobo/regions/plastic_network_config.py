"""The configuration of a network whose synapses learn by local rules while it runs."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from neurorobo.clock import Clock
from neurorobo.errors import ConfigError, Fault, did_you_mean
from neurorobo.plasticity import LearningRule, ModulatedRule
from neurorobo.plugged_field import Plugged
from neurorobo.regions.config import Path
from neurorobo.regions.feedforward_config import Quantity
from neurorobo.regions.port import Port
from neurorobo.regions.spiking_network_config import INPUTS, LayerConfig, Name, NetworkConfig
from neurorobo.units import Duration, Interval, Unit, parse_quantity

RECURRENT = "recurrent"
"""Under `synapses`, those of a layer's neurons on one another."""


def _read_rule(value: object, read: ValidatorFunctionWrapHandler) -> LearningRule:
    """Read a rule; a phase of training, which is registered as a rule too and has no `type`, is refused as such."""
    try:
        rule: LearningRule = read(value)
    except ValidationError as error:
        if any(fault["loc"] == ("type",) and "unknown key" in fault["msg"] for fault in error.errors()):
            raise ValueError(
                "is a phase of training, not a rule that synapses learn by; write it under `train`"
            ) from None
        raise
    return rule


class SynapsesConfig(BaseModel):
    """What the synapses from one source are, and how they learn."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    fan_in: int | None = Field(
        default=None, ge=1, description="How many sources each neuron hears, drawn once; all if left out."
    )
    gain: float | None = Field(
        default=None,
        gt=0,
        description="Fresh weights are drawn with the standard deviation gain / sqrt(fan-in); if left out, the "
        "network's `gain`, and 0.5 for `recurrent`.",
    )
    sign: Literal["excitatory", "inhibitory"] | None = Field(
        default=None, description="The sign that all weights have and keep; any if left out."
    )
    bounds: Annotated[Interval, Unit("1")] | None = Field(
        default=None, description="The weights that learning may lead to, such as 0..0.5; needed where they learn."
    )
    learns: tuple[Annotated[LearningRule, Plugged("rule"), WrapValidator(_read_rule)], ...] = Field(
        default=(), description="The rules that they learn by, whose changes add up; none if left out."
    )

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        if self.learns and self.bounds is None:
            raise ValueError("say between which weights these synapses learn, such as `bounds: 0..0.5`")
        if self.bounds is not None and not self.learns:
            raise ValueError("`bounds` are for synapses that learn; say how, under `learns`, or leave them out")
        if self.bounds is not None:
            wrong = {"excitatory": self.bounds.lo < 0, "inhibitory": self.bounds.hi > 0}
            if wrong.get(self.sign or ""):
                raise ValueError(f"{self.sign} synapses cannot learn weights of the other sign; change `bounds`")
        return self


class PlasticLayerConfig(LayerConfig):
    """A population of neurons, what excites it, and what its synapses learn."""

    synapses: dict[str, SynapsesConfig] = Field(
        default={},
        description="What is particular of the synapses from one source, by what the layer `reads`, or `recurrent`.",
    )


class Modulator(BaseModel):
    """A quantity that tells synapses how much to learn; it holds for all steps of a window.

    Why a reward had better come without its mean: Fremaux, Sprekeler & Gerstner 2010.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    unit: str = Field(default="1", description="The unit of the quantity, such as mN.")
    width: int = Field(default=1, ge=1, description="The number of components.")
    initial: Quantity | None = Field(
        default=None,
        description="The value of all components before its source has spoken, which a delayed one needs; without it, "
        "the modulator has to be wired.",
    )
    baseline: Annotated[Duration, Field(gt=0)] | None = Field(
        default=None,
        description="The time over which its mean is taken, so that synapses are told what is more than usual, as a "
        "reward should be; nothing is taken off if left out.",
    )

    def port(self) -> Port:
        """Return the port; a ValueError if the initial value is not of the unit."""
        initial = None if self.initial is None else (parse_quantity(self.initial, self.unit),) * self.width
        return Port(self.unit, self.width, initial=initial)


class PlasticNetworkConfig(NetworkConfig):
    """The layers of a `spiking_network`, of which some synapses learn by local rules while the brain runs.

    What they learn is part of the state and has the weights as its beginning, which stay as they were trained: those of
    a `spiking_network` of the same layers fit. Each modulator is an input that carries numbers.
    """

    implementation: ClassVar[str] = "neurorobo.regions.plastic_network:PlasticNetwork"
    accumulates: ClassVar[bool] = True

    type: Literal["plastic_network"] = "plastic_network"  # type: ignore[assignment]
    carry: Literal["always"] = Field(
        default="always", description="How long the state lives: always, or nothing would be learned."
    )
    layers: dict[Name, PlasticLayerConfig] = Field(min_length=1, description="The layers, by name, in order.")  # type: ignore[assignment]
    modulators: dict[Name, Modulator] = Field(
        default={}, description="What rules are told, such as a reward or an error; further inputs, by name."
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Return what it receives, modulators last; a ConfigError if synapses cannot learn as they are to."""
        ports = super().inputs(clock)
        if faults := [*self._synapse_faults(ports, clock), *self._modulator_faults()]:
            raise ConfigError(faults)
        return ports | {name: told.port() for name, told in self.modulators.items()}

    def signature(self, clock: Clock) -> Mapping[str, Any]:
        """Return that of a `spiking_network` of these layers, whose weights fit; and fan-ins, if there are any."""
        layers = {name: layer.model_dump(mode="json", exclude={"synapses"}) for name, layer in self.layers.items()}
        for name, key, synapses in self.synapses():
            if synapses.fan_in is not None:
                layers[name].setdefault("fan_in", {})[key] = synapses.fan_in
        channels = sum(port.channels for port in super().inputs(clock).values())
        return {"type": NetworkConfig.model_fields["type"].default, "inputs": channels, "layers": layers}

    def needs_spikes(self, path: Path) -> bool:
        """Whether the neuron at a path has to send spikes, as all have: rules and the layers that learn read them."""
        return True

    def synapses(self) -> Iterator[tuple[str, str, SynapsesConfig]]:
        """Yield the layer, the source and the settings of all synapses that have some."""
        for name, layer in self.layers.items():
            for key, synapses in layer.synapses.items():
                yield name, key, synapses

    def _synapse_faults(self, ports: Mapping[str, Port], clock: Clock) -> Iterator[Fault]:
        sizes = {name: port.channels for name, port in ports.items()}
        sizes |= {INPUTS: sum(sizes.values())} | {name: layer.neurons for name, layer in self.layers.items()}
        if not any(synapses.learns for _, _, synapses in self.synapses()):
            yield Fault(("layers",), "no synapses learn; say which, under `synapses`, or take a `spiking_network`")
        if RECURRENT in sizes:
            where = "layers" if RECURRENT in self.layers else "inputs"
            yield Fault((where, RECURRENT), f"`{RECURRENT}` stands for the synapses within a layer; call it otherwise")
        for name, key, synapses in self.synapses():
            layer = self.layers[name]
            place: tuple[str | int, ...] = ("layers", name, "synapses", key)
            known = [*layer.reads, *([RECURRENT] if layer.recurrent else [])]
            if key not in known:
                yield Fault(place, f"the layer `{name}` has no synapses from `{key}`{did_you_mean(key, known)}")
            elif layer.reads.count(key) > 1:
                yield Fault(place, f"the layer `{name}` reads `{key}` more than once; let it do so once")
            elif synapses.fan_in is not None and key == RECURRENT:
                yield Fault((*place, "fan_in"), "neurons of a layer hear all others; leave this out")
            elif synapses.fan_in is not None and synapses.fan_in > sizes[key]:
                yield Fault((*place, "fan_in"), f"`{key}` has {sizes[key]} neurons; take no more")
            if not synapses.learns:
                continue
            neuron = layer.neuron.build(clock.spike_step_ns)
            for number, rule in enumerate(synapses.learns):
                for fault in (*rule.faults(clock, neuron), *self._told_faults(rule, layer)):
                    yield Fault((*place, "learns", number, *fault.path), fault.message)

    def _told_faults(self, rule: LearningRule, layer: LayerConfig) -> Iterator[Fault]:
        """Yield why a rule cannot be told its modulator, if it has one."""
        if not isinstance(rule, ModulatedRule) or rule.modulator is None:
            return
        if rule.modulator not in self.modulators:
            known = did_you_mean(rule.modulator, self.modulators)
            yield Fault(("modulator",), f"`{rule.modulator}` is none of the `modulators` of the region{known}")
            return
        width = self.modulators[rule.modulator].width
        if rule.feedback == "groups" and layer.neurons % width:
            yield Fault(
                ("feedback",),
                f"{layer.neurons} neurons cannot be divided into {width} equal groups, one for each component of "
                f"`{rule.modulator}`; change the number, or say `feedback: random`",
            )

    def _modulator_faults(self) -> Iterator[Fault]:
        asked = {
            rule.modulator
            for _, _, synapses in self.synapses()
            for rule in synapses.learns
            if isinstance(rule, ModulatedRule)
        }
        for name in self.modulators:
            if name in self.receives:
                yield Fault(("modulators", name), "is the name of an input too; call it otherwise")
            if name not in asked:
                yield Fault(("modulators", name), "no rule names it as its `modulator`; let one do so, or leave it out")
