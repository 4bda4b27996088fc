"""What a region does with its spikes is found out, and what is more than wiring is refused."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import pytest
import torch
from samples import CLOCK
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.codes import PopulationUniform
from neurorobo.engine import Circuit, Layer
from neurorobo.errors import NeuroroboError
from neurorobo.interchange.export import to_graph
from neurorobo.interchange.wiring import INPUT, wiring_of
from neurorobo.neurons import LIF
from neurorobo.plugins import Registry
from neurorobo.regions import Port, RegionConfig
from neurorobo.regions.plastic import Plastic
from neurorobo.regions.region import Probe, Region, State
from neurorobo.synapses import Dense
from tests.regions.toys import Net, NetConfig

CODE = PopulationUniform(3, 0.0, 1.0)


class PairConfig(RegionConfig):
    implementation: ClassVar[str] = "none"
    type: str = "pair"
    numeric: bool = False

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"a": Port("1", 1, CODE), "b": Port("1", 2, None if self.numeric else CODE)}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"late": Port("1", 2, CODE), "early": Port("1", 1, CODE), "rate": Port("1")}


class Pair(Region):
    """Two layers; the second input is read first, the output is turned round, and one port carries numbers."""

    def __init__(self, config: RegionConfig) -> None:
        generator = torch.Generator().manual_seed(0)
        super().__init__(config, CLOCK, generator)
        self.first = Layer([Dense(9, 4, generator)], LIF())
        self.second = Layer([Dense(4, 9, generator), Dense(6, 9, generator)], LIF())
        self.circuit = Circuit(
            ["b", "a"], {"first": (self.first, [("b", "a")]), "second": (self.second, ["first", "b"])}
        )

    def init_state(self, batch: int) -> State:
        return {"second": self.second.at_rest(batch)}

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        spikes, after = self.circuit(inputs, state, ["first", "second"], probe)
        second = spikes["second"]
        return {"late": second[..., 3:], "early": second[..., :3], "rate": spikes["first"].mean((0, 2))[:, None]}, after


def test_a_wiring_says_what_is_read_where_and_what_is_sent() -> None:
    wiring = wiring_of(Pair(PairConfig()))
    assert wiring.readings["first"] == [[*((INPUT, n) for n in range(3, 9)), *((INPUT, n) for n in range(3))]]
    assert wiring.readings["second"] == [[("first", n) for n in range(4)], [(INPUT, n) for n in range(3, 9)]]
    assert wiring.outputs == {"late": ("second", [*range(3, 9)]), "early": ("second", [*range(3)])}
    assert wiring.numeric == ("rate",)
    assert wiring.carried == {"second"}


def test_a_layer_that_reads_constant_currents_alone_keeps_them() -> None:
    class Constant(Pair):
        def step(
            self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
        ) -> tuple[dict[str, Tensor], State]:
            ones = {name: torch.ones_like(spikes) for name, spikes in inputs.items()}
            return super().step(ones, state, probe)

    region = Constant(PairConfig())
    nodes = to_graph(region, Registry())[0].nodes
    assert not nodes["first.from_input"].weight.any()
    assert nodes["first.from_input"].weight.shape == (4, 9)
    weight = region.first.projections[0].get_parameter("weight").detach()
    assert nodes["first.from_input"].bias == pytest.approx(weight.sum(1).numpy(), rel=1e-5)


def test_asking_changes_nothing() -> None:
    region = Pair(PairConfig())
    before, circuit = dict(vars(region)), region.circuit
    wiring_of(region)
    assert vars(region) == before
    assert region.circuit is circuit


def doing(change: Callable[[Any, dict[str, Tensor]], Any]) -> type[Pair]:
    """Return a region that does something with the spikes of `Pair` that no wiring can say."""

    class Other(Pair):
        def step(
            self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
        ) -> tuple[dict[str, Tensor], State]:
            outputs, after = super().step(inputs, state, probe)
            return {**outputs, "late": change(self, outputs)}, after

    return Other


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda region, said: said["late"].flip(0), "makes of spikes something else before `late`"),
        (lambda region, said: 1 - said["late"], "makes of spikes something else before `late`"),
        (lambda region, said: said["late"] + said["early"].repeat(1, 1, 2), "something else before `late`"),
        (lambda region, said: said["late"][:1], "something else before `late`"),
        (lambda region, said: torch.maximum(said["late"], said["late"].flip(2)), "something else before `late`"),
        (lambda region, said: torch.minimum(said["late"], said["late"].flip(2)), "something else before `late`"),
        (lambda region, said: said["late"].sort(dim=2).values, "something else before `late`"),
        (lambda region, said: said["late"] - said["late"][..., :1] + said["early"][..., 2:], "before `late`"),
        (lambda region, said: said["late"].new_ones(2, 1, 6), "`late` is not of the neurons of one layer"),
        (lambda region, said: region.nothing, "does more with spikes than to wire them"),
        (lambda region, said: Pair.step(region, {"a": 0, "b": 0}, {})[0]["late"], "its circuit several times"),
    ],
)
def test_what_is_more_than_wiring_is_refused(change: Callable[[Any, dict[str, Tensor]], Any], words: str) -> None:
    with pytest.raises(NeuroroboError, match=words):
        wiring_of(doing(change)(PairConfig()))


@pytest.mark.parametrize(
    "change",
    [
        lambda a, b: torch.maximum(a, b[..., :3]),
        lambda a, b: (a + b[..., :3]).clamp(max=1),
        lambda a, b: (a > 0).float(),
        lambda a, b: a - b[..., :3] + b[..., 3:],
        lambda a, b: a.cummax(0).values,
    ],
)
def test_what_is_computed_before_the_circuit_is_refused(change: Callable[[Tensor, Tensor], Tensor]) -> None:
    class Other(Pair):
        def step(
            self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
        ) -> tuple[dict[str, Tensor], State]:
            return super().step({**inputs, "a": change(inputs["a"], inputs["b"])}, state, probe)

    with pytest.raises(NeuroroboError, match="makes of spikes something else before `a`"):
        wiring_of(Other(PairConfig()))


def test_what_is_no_circuit_is_refused_by_its_name() -> None:
    class Learning(Pair, Plastic):
        learned = ()

    with pytest.raises(NeuroroboError, match="it learns while it runs"):
        wiring_of(Learning(PairConfig()))
    with pytest.raises(NeuroroboError, match="its input `b` carries numbers"):
        wiring_of(Pair(PairConfig(numeric=True)))
    region = Pair(PairConfig())
    region.spare = Layer([Dense(2, 2, torch.Generator())], LIF())
    with pytest.raises(NeuroroboError, match="the layer `spare` is no part of its circuit"):
        wiring_of(region)
    region = Pair(PairConfig())
    region.second_circuit = region.circuit
    with pytest.raises(NeuroroboError, match="it holds 2 circuits"):
        wiring_of(region)
    with pytest.raises(NeuroroboError, match="it holds no circuit"):
        wiring_of(Net(NetConfig(), CLOCK, torch.Generator()))
