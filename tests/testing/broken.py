"""Regions that each break the contract in one way, by way of the small network of `tests.regions.toys`."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.codes import PopulationUniform
from neurorobo.regions import Port
from neurorobo.regions.region import Probe, State
from neurorobo.synapses import Dense
from tests.regions.toys import Net, NetConfig

Step = tuple[dict[str, Tensor], State]
Inputs = Mapping[str, Tensor]


class CountsItsCalls(Net):
    calls = 0

    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        self.calls += 1
        return super().step(inputs, state, probe)


class WritesADiary(Net):
    def __init__(self, config: NetConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self.diary: list[Tensor] = []

    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        self.diary.append(inputs["force"])
        return super().step(inputs, state, probe)


class LearnsOnTheQuiet(Net):
    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        result = super().step(inputs, state, probe)
        self.output.projections[1].weight.mul_(0.99)  # type: ignore[union-attr, operator]
        return result


class SilencesItsInput(Net):
    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        result = super().step(inputs, state, probe)
        inputs["force"][0] = 0.0
        return result


class ChangesItsStateInPlace(Net):
    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        outputs, after = super().step(inputs, state, probe)
        state["hidden"].copy_(after["hidden"])
        return outputs, {**after, "hidden": state["hidden"]}


class ReplacesItsState(Net):
    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        outputs, after = super().step(inputs, state, probe)
        state.update(after)
        return outputs, after


class ForgetsAnOutput(Net):
    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        outputs, after = super().step(inputs, state, probe)
        return {"moved": outputs["move"]}, after


class ReturnsOnlyItsOutputs(Net):
    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Any:
        return super().step(inputs, state, probe)[0]


class ChangesOutputs(Net):
    """Base of those whose output is not what its port says."""

    change: ClassVar[Callable[[Tensor], Tensor]]

    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        outputs, after = super().step(inputs, state, probe)
        return {"move": type(self).change(outputs["move"])}, after


class PutsTheBatchFirst(ChangesOutputs):
    change = staticmethod(lambda spikes: spikes.transpose(0, 1))


class ReturnsDoubles(ChangesOutputs):
    change = staticmethod(lambda spikes: spikes.double())


class GradesItsSpikes(ChangesOutputs):
    change = staticmethod(lambda spikes: spikes * 0.5)


class IsNotANumber(ChangesOutputs):
    change = staticmethod(lambda spikes: spikes / spikes)


class MixesTheBatch(ChangesOutputs):
    change = staticmethod(lambda spikes: spikes.amax(1, keepdim=True).expand_as(spikes))


class FiresAtRandom(ChangesOutputs):
    change = staticmethod(lambda spikes: (torch.rand_like(spikes) < 0.5).float())


class PutsTheBatchLastInItsState(Net):
    def init_state(self, batch: int) -> State:
        return {name: potential.t() for name, potential in super().init_state(batch).items()}


class GrowsItsState(Net):
    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        outputs, after = super().step(
            inputs, {k: v[:, :n] for (k, v), n in zip(state.items(), (10, 6), strict=True)}, probe
        )
        return outputs, {name: torch.cat([v, v], 1) for name, v in after.items()}


class ActsUpWhenWatched(Net):
    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        outputs, after = super().step(inputs, state, probe)
        return {"move": outputs["move"] if probe is None else 1 - outputs["move"]}, after


class TellsTheProbeNothing(Net):
    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        return super().step(inputs, state)


class TellsTheProbeItsPotentials(Net):
    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        outputs, after = super().step(inputs, state)
        if probe is not None:
            probe("hidden", after["hidden"])
        return outputs, after


class DrawsFromTheGlobalGenerator(Net):
    def __init__(self, config: NetConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self.register_buffer("bias", torch.randn(3))


class HidesWeights(Net):
    """A plain tensor is not saved."""

    def __init__(self, config: NetConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self.order = torch.randperm(config.neurons, generator=generator)

    def step(self, inputs: Inputs, state: State, probe: Probe | None = None) -> Step:
        outputs, after = super().step(inputs, state, probe)
        return {"move": outputs["move"][..., self.order]}, after


class HasHugeWeights(Net):
    def __init__(self, config: NetConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self.output.projections[1].weight.data.mul_(1000.0)  # type: ignore[union-attr, operator]


class Unruly(Dense):
    """Its weights go where they like."""

    def constrain(self) -> None:
        pass


class BreaksDalesLaw(Net):
    def __init__(self, config: NetConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self.output.projections[0] = Unruly(config.hidden, config.neurons, generator, sign="inhibitory")


class BreaksDalesLawFromTheStart(Net):
    def __init__(self, config: NetConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self.output.projections[0].weight.data.neg_()  # type: ignore[union-attr, operator]


REGIONS: dict[type[Net], str] = {
    CountsItsCalls: "`step` changed the attribute `calls`",
    WritesADiary: "`step` changed the attribute `diary`",
    LearnsOnTheQuiet: "`step` changed the attribute `output.projections.1.weight`",
    SilencesItsInput: "`step` changed its input `force`",
    ChangesItsStateInPlace: "`step` changed the state `hidden` that it was given",
    ReplacesItsState: "`step` changed the state `hidden` that it was given",
    ForgetsAnOutput: "returned the outputs ['moved'], but its ports are ['move']",
    ReturnsOnlyItsOutputs: "`step` must return two dictionaries",
    PutsTheBatchFirst: "the output `move` is [3, 50, 6], wanted [50, 3, 6]: steps, batch, width * neurons",
    ReturnsDoubles: "the output `move` is torch.float64, wanted torch.float32",
    GradesItsSpikes: "the output `move` holds other values than 0 and 1",
    IsNotANumber: "the output `move` is not finite",
    MixesTheBatch: "the output `move` of member 0 of a batch of 3 differs from the same run alone",
    FiresAtRandom: "two equal calls of `step` differ in the output `move`",
    PutsTheBatchLastInItsState: "the state `hidden` of a batch of 1 is (10, 1)",
    GrowsItsState: "`step` returned a state of {'hidden': ((3, 20)",
    ActsUpWhenWatched: "`step` with a probe differs from the one without in the output `move`",
    TellsTheProbeNothing: "the probe heard none",
    TellsTheProbeItsPotentials: "the probe was given (3, 10) of the layer `hidden`",
    DrawsFromTheGlobalGenerator: "`bias` differs when it is built again with the same seed",
    HidesWeights: "with the same weights loaded, the output `move` differs",
    HasHugeWeights: "its weights cannot be saved and loaded again",
    BreaksDalesLaw: "the inhibitory synapses `output.projections.0` hold weights of the other sign after `constrain`",
    BreaksDalesLawFromTheStart: "the inhibitory synapses `output.projections.0` hold weights of the other sign when it",
}


def config_of(region: type[Net]) -> NetConfig:
    """The small network's configuration, for another network."""
    implementation = f"{region.__module__}:{region.__name__}"
    config: NetConfig = type("Config", (NetConfig,), {"implementation": implementation, "__module__": __name__})()
    return config


class MutableInputs(NetConfig):
    """Base of those whose ports are at fault."""

    port: ClassVar[Port]
    name: ClassVar[str] = "force"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {self.name: self.port}


class SpeaksOfSpans(MutableInputs):
    port = Port("span", 2, PopulationUniform(6, -1.0, 1.0))


class StartsOutOfRange(MutableInputs):
    port = Port("mN", 2, PopulationUniform(6, -1.0, 1.0), initial=(0.0, 3.0))


class HasADottedPort(MutableInputs):
    port = Port("mN", 2, PopulationUniform(6, -1.0, 1.0))
    name = "force.x"


class HasAPortCalledState(MutableInputs):
    port = Port("mN", 2, PopulationUniform(6, -1.0, 1.0))
    name = "state"


class HasNoOutput(NetConfig):
    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {}


class ChangesItsMind(NetConfig):
    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {f"move_{torch.rand(()).item()}".replace(".", ""): Port("um")}


class SignsWithItsWeights(NetConfig):
    def signature(self, clock: Clock) -> Mapping[str, Any]:
        return self.model_dump()


class SignsWithObjects(NetConfig):
    def signature(self, clock: Clock) -> Mapping[str, Any]:
        return {"ports": self.inputs(clock)}


CONFIGS: dict[type[NetConfig], str] = {
    SpeaksOfSpans: "the input port `force`: 'span' is not a unit",
    StartsOutOfRange: "the input port `force` starts at 3.0, out of its code's range -1.0..1.0",
    HasADottedPort: "the input port `force.x` cannot be referred to",
    HasAPortCalledState: "the input port `state` cannot be wired",
    HasNoOutput: "it has no output",
    ChangesItsMind: "its output ports differ from call to call",
    SignsWithItsWeights: "its `signature` changes with `weights`",
    SignsWithObjects: "its `signature` is not JSON",
}
