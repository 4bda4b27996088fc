"""A circuit: the spikes and states of its layers run one by one, bit for bit, whatever is wired to what.

Weights lie on a grid, as in `test_native.py`: no order of summation then matters, nor which path takes which layer.
"""

import copy
import os
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, NamedTuple

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn
from torch.nn.utils import parametrize, prune

from neurorobo.engine import Circuit, Fired, Layer, kernels
from neurorobo.engine.circuit import Reads
from neurorobo.neurons import LIF, Surrogate
from neurorobo.regions.weights import to_grid
from neurorobo.synapses import Dense, FanIn, Projection
from tests.engine.paths import engine, instruction_sets, needs_native
from tests.engine.test_native import MEMORIES, arranged, generator, spikes
from tests.engine.test_torch import run as run_program


@pytest.fixture(
    autouse=True,
    params=["portable", *(pytest.param(name, marks=needs_native()) for name in instruction_sets() or [""])],
)
def path(request: pytest.FixtureRequest) -> Iterator[str]:
    """The portable path, and the native one with each instruction set."""
    portable = request.param == "portable"
    with engine("portable" if portable else "native", "" if portable else request.param):
        yield "portable" if portable else "native"


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Let the kernels, but not torch, use threads for windows however small."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch, "get_num_threads", lambda: count)
        patch.setattr(kernels, "WORK_FOR_THREADS", 0)
        yield


@contextmanager
def in_one_call(path: str) -> Iterator[None]:
    """Let no layer run by itself on the native path."""

    def fail(*_: object) -> None:
        raise AssertionError("a layer ran by itself")

    with pytest.MonkeyPatch.context() as patch:
        if path == "native":
            patch.setattr(Layer, "forward", fail)
        yield


Wiring = Mapping[str, tuple[Layer, Sequence[Reads]]]


def one_by_one(
    wiring: Wiring, inputs: Mapping[str, Tensor], state: Mapping[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """What a circuit is to give."""
    known, after = dict(inputs), {}
    for name, (layer, reads) in wiring.items():
        given = [known[read] if isinstance(read, str) else torch.cat([known[r] for r in read], -1) for read in reads]
        known[name], last = layer(given, state.get(name))
        if name in state:
            after[name] = last
    return {name: known[name] for name in wiring}, after


def assert_same(found: Sequence[Mapping[str, Tensor]], expected: Sequence[Mapping[str, Tensor]]) -> None:
    for tensors, theirs in zip(found, expected, strict=True):
        assert tensors.keys() == theirs.keys()
        for name, tensor in tensors.items():
            assert torch.equal(tensor, theirs[name]), name


def on_grid(layer: Layer, places: int = 12) -> Layer:
    with torch.no_grad():
        for parameter in layer.parameters():
            parameter.copy_(to_grid(parameter, places))
    return layer


class Network(nn.Module):
    """A join that is read twice and begins within words, a fan-in, a recurrent layer and trained thresholds."""

    def __init__(self, neuron: LIF | None = None) -> None:
        super().__init__()
        neuron = LIF(surrogate=Surrogate("arctan")) if neuron is None else neuron
        join, deep = ("a", "b", "c"), ("first", "a", "second")
        g = generator(2)
        layers: dict[str, tuple[Layer, Sequence[Reads]]] = {
            "first": (Layer([FanIn(133, 65, 4, g, gain=1.5)], neuron), [join]),
            "second": (Layer([Dense(133, 70, g), Dense(65, 70, g)], neuron, trainable_threshold=True), [join, "first"]),
            "third": (Layer([Dense(140, 40, g, gain=1.5)], neuron, Dense(40, 40, g, gain=0.6)), [deep]),
            "output": (Layer([Dense(40, 9, g, gain=2.0)], neuron), ["third"]),
        }
        self.layers = nn.ModuleDict({name: on_grid(layer) for name, (layer, _) in layers.items()})
        self.reads = {name: reads for name, (_, reads) in layers.items()}
        self.circuit = Circuit(["a", "b", "c"], layers)

    def wiring(self) -> Wiring:
        return {name: (self.layers[name], reads) for name, reads in self.reads.items()}  # type: ignore[misc]

    def forward(self, inputs: Mapping[str, Tensor], **others: Any) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        return self.circuit(inputs, **others)

    def alone(
        self, inputs: Mapping[str, Tensor], state: Mapping[str, Tensor] | None = None
    ) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        return one_by_one(self.wiring(), inputs, {} if state is None else state)

    def at_rest(self, batch: int) -> dict[str, Tensor]:
        return {name: layer.at_rest(batch) for name, (layer, _) in self.wiring().items()}

    def projection(self, layer: str, number: int = 0) -> nn.Module:
        projections: nn.ModuleList = self.layers[layer].projections  # type: ignore[assignment]
        return projections[number]


SIZES = {"a": 5, "b": 65, "c": 63}


def window(steps: int = 20, batch: int = 3, rate: float = 0.3, seed: int = 1) -> dict[str, Tensor]:
    return {name: spikes(steps, batch, size, rate, seed + i) for i, (name, size) in enumerate(SIZES.items())}


class Problem(NamedTuple):
    sizes: dict[str, int]
    wiring: Wiring
    steps: int
    batch: int
    carried: list[str]
    wanted: list[str] | None
    memory: str
    threads: int


EDGES = st.sampled_from([1, 5, 31, 63, 64, 65, 127, 130])


@st.composite
def problems(draw: st.DrawFn) -> Problem:
    sizes = {f"input {i}": draw(EDGES) for i in range(draw(st.integers(1, 3)))}
    known, groups, wiring = dict(sizes), [], {}
    for number in range(draw(st.integers(1, 4))):
        neurons, projections, reads = draw(EDGES | st.integers(1, 280)), list[Projection](), list[Reads]()
        for i in range(draw(st.integers(1, 2))):
            if groups and draw(st.booleans()):
                group = draw(st.sampled_from(groups))
            else:
                group = tuple(draw(st.lists(st.sampled_from(list(known)), min_size=1, max_size=4)))
                groups.append(group)
            sources, seed = sum(known[name] for name in group), generator(10 * number + i)
            if draw(st.integers(0, 2)) == 0:
                projections.append(FanIn(sources, neurons, min(sources, 3), seed, gain=1.2))
            else:
                projections.append(Dense(sources, neurons, seed, gain=1.2))
            reads.append(group[0] if len(group) == 1 and draw(st.booleans()) else group)
        own = Dense(neurons, neurons, generator(9), gain=0.6) if draw(st.booleans()) else None
        layer = Layer(projections, LIF(rectify=draw(st.booleans())), own, trainable_threshold=draw(st.booleans()))
        if layer.threshold is not None:
            with torch.no_grad():
                layer.threshold += 0.2 * torch.rand(neurons, generator=generator(8))
        name = f"layer {number}"
        wiring[name] = (on_grid(layer, draw(st.sampled_from([4, 12]))), reads)  # few places fit into bytes
        known[name] = neurons
    names = list(wiring)
    some = st.lists(st.sampled_from(names), unique=True)
    return Problem(
        sizes,
        wiring,
        draw(st.integers(1, 70)),
        draw(st.integers(0, 20)),
        draw(some),
        draw(st.none() | some),
        draw(st.sampled_from(MEMORIES)),
        draw(st.sampled_from([1, 2, 3])),
    )


@given(problem=problems(), rate=st.sampled_from([0.1, 0.4, 0.9]))
@settings(max_examples=int(os.environ.get("NEUROROBO_FUZZ", "40")))
@torch.no_grad()
def test_all_wirings_give_what_their_layers_give(problem: Problem, rate: float) -> None:
    circuit = Circuit(problem.sizes, problem.wiring)
    state = {
        name: to_grid(1.3 * torch.rand(problem.batch, problem.wiring[name][0].neurons, generator=generator(3)), 12)
        for name in problem.carried
    }
    for seed in (1, 50):  # the second time as it was prepared
        inputs = {
            name: arranged(spikes(problem.steps, problem.batch, size, rate, seed + i), problem.memory)
            for i, (name, size) in enumerate(problem.sizes.items())
        }
        fired, after = one_by_one(problem.wiring, inputs, state)
        if problem.wanted is not None:
            fired = {name: spikes for name, spikes in fired.items() if name in problem.wanted}
        before = copy.deepcopy((inputs, state))
        with threads(problem.threads):
            found = circuit(inputs, state, problem.wanted)
        assert_same(found, (fired, after))
        assert_same((inputs, state), before)  # they are left alone
        state = after


@pytest.mark.parametrize("rectify", [False, True])
@torch.no_grad()
def test_one_call_runs_all_layers(path: str, rectify: bool) -> None:
    network = Network(LIF(rectify=rectify))
    for seed in (1, 20):
        expected = network.alone(window(seed=seed))
        assert all(0.02 < fired.mean() < 0.7 for fired in expected[0].values())
        with in_one_call(path):
            assert_same(network(window(seed=seed)), expected)


@torch.no_grad()
def test_threads_change_nothing(path: str) -> None:
    """With work enough for torch's own number of threads."""
    g = generator()
    first = on_grid(Layer([Dense(700, 600, g)], LIF()))
    second = on_grid(Layer([FanIn(1300, 500, 5, g, gain=1.5), Dense(600, 500, g)], LIF(), Dense(500, 500, g, gain=0.3)))
    wiring: Wiring = {"first": (first, ["a"]), "second": (second, [("first", "a"), "first"])}
    circuit, inputs = Circuit(["a"], wiring), {"a": spikes(30, 40, 700)}
    assert inputs["a"].sum() * 600 > kernels.WORK_FOR_THREADS
    before, found = torch.get_num_threads(), []
    try:
        for count in (1, 2, 2, 1):
            torch.set_num_threads(count)
            with in_one_call(path):
                found.append(circuit(inputs))
    finally:
        torch.set_num_threads(before)
    for other in (*found[1:], one_by_one(wiring, inputs, {})):
        assert_same(found[0], other)


@pytest.mark.parametrize("carried", [[], ["third"], ["first", "output"], ["first", "second", "third", "output"]])
@pytest.mark.parametrize("wanted", [None, [], ["output"], ["second", "first"]])
@pytest.mark.parametrize("training", [True, False])
def test_only_what_is_asked_for_is_returned(carried: list[str], wanted: list[str] | None, training: bool) -> None:
    network = Network()
    state = {name: tensor for name, tensor in network.at_rest(3).items() if name in carried}
    with torch.set_grad_enabled(training):
        for _ in range(2):
            spikes, after = network(window(), state=state, wanted=wanted)
            assert list(after) == carried
            assert set(spikes) == set(network.layers if wanted is None else wanted)
            assert_same((spikes, after), ({name: network.alone(window())[0][name] for name in spikes}, after))
            state = {name: torch.zeros_like(last) for name, last in after.items()}


@torch.no_grad()
def test_layers_without_a_state_start_at_rest_whatever_ran_before() -> None:
    network, state = Network(), {name: rest + 0.3 for name, rest in Network().at_rest(3).items()}
    expected = network.alone(window(2))
    for _ in range(2):
        assert_same(network(window(2)), expected)
        given = network(window(2), state=state)
        assert_same(given, network.alone(window(2), state))
        assert not torch.equal(given[0]["first"], expected[0]["first"])


@pytest.mark.parametrize("pieces", [[1] * 70, [64, 6], [3, 3, 64]], ids=["streaming", "word", "uneven"])
@torch.no_grad()
def test_a_window_in_pieces_is_the_whole_window(pieces: list[int]) -> None:
    network, inputs = Network(), window(70, 2)
    state, parts = network.at_rest(2), []
    whole, last = network(inputs, state=state)
    for piece in zip(*(tensor.split(pieces) for tensor in inputs.values()), strict=True):
        fired, state = network(dict(zip(inputs, piece, strict=True)), state=state)
        parts.append(fired)
    assert_same(({name: torch.cat([part[name] for part in parts]) for name in whole}, state), (whole, last))


@torch.no_grad()
def test_windows_of_other_sizes_leave_nothing_behind() -> None:
    """As many words in all, but other steps and another batch; and silence after many spikes."""
    network = Network()
    for steps, batch, rate in [(12, 2, 0.6), (6, 4, 0.1), (4, 6, 0.5), (4, 6, 0.0), (4, 0, 0.5), (4, 6, 0.2)]:
        assert_same(network(window(steps, batch, rate)), network.alone(window(steps, batch, rate)))


def test_gradients_go_through_as_through_the_layers() -> None:
    found = []
    for run in (Network.forward, Network.alone):
        network = Network()
        inputs = {name: x.requires_grad_() for name, x in window().items()}
        state = {name: x.requires_grad_() for name, x in network.at_rest(3).items()}
        spikes, after = run(network, inputs, state=state)
        outputs = [*spikes.values(), *after.values()]
        loss = sum((x * torch.randn(x.shape, generator=generator(i))).sum() for i, x in enumerate(outputs))
        leaves = {**dict(network.named_parameters()), **inputs, **{f"{name} before": x for name, x in state.items()}}
        found.append(dict(zip(leaves, torch.autograd.grad(loss, list(leaves.values())), strict=True)))  # type: ignore[arg-type]
    assert all(gradient.any() for gradient in found[1].values())
    for name, gradient in found[0].items():  # of what is read several times, added up in another order
        assert (gradient - found[1][name]).abs().max() <= 1e-5 * found[1][name].abs().max(), name


def changes(network: Network) -> dict[str, Callable[[], object]]:
    def fused_adam() -> None:
        optimiser = torch.optim.Adam(network.parameters(), lr=0.1, fused=True)
        for parameter in network.parameters():
            parameter.grad = torch.randn(parameter.shape, generator=generator(5))
        optimiser.step()
        for name in network.layers:
            on_grid(network.layers[name])  # type: ignore[arg-type]

    def another(projection: Projection) -> Projection:
        with torch.no_grad():
            projection.weight.copy_(to_grid(projection.weight, 12))  # type: ignore[arg-type, operator]
        return projection

    first, second, third = (network.layers[name] for name in ("first", "second", "third"))
    index: Tensor = network.projection("first").source_index  # type: ignore[assignment]
    weight: Tensor = network.projection("second").weight  # type: ignore[assignment]
    return {
        "in place": lambda: weight.mul_(-1),
        "optimiser": fused_adam,
        "parameter": lambda: setattr(network.projection("second"), "weight", nn.Parameter(weight.roll(1, 0))),
        "projection": lambda: second.projections.__setitem__(1, another(Dense(65, 70, generator(4), gain=2.0))),  # type: ignore[operator]
        "kind": lambda: third.projections.__setitem__(0, another(FanIn(140, 40, 5, generator(4), gain=2.0))),  # type: ignore[operator]
        "recurrent": lambda: setattr(third, "recurrent", another(Dense(40, 40, generator(4), gain=2.0))),
        "no recurrent": lambda: setattr(third, "recurrent", None),
        "index": lambda: index.copy_(index.roll(1, 0)),
        "neuron": lambda: setattr(first, "neuron", LIF(threshold=0.25)),
        "threshold": lambda: second.threshold.add_(0.5),  # type: ignore[operator]
        "no threshold": lambda: (second.threshold.add_(0.5), setattr(second, "threshold", None)),  # type: ignore[operator, func-returns-value]
    }


@pytest.mark.parametrize("kind", changes(Network()))
@torch.no_grad()
def test_every_change_is_noticed(kind: str) -> None:
    network, inputs = Network(), window()
    if kind == "no threshold":
        network.layers["second"].threshold.add_(0.5)  # type: ignore[operator]
    before = network(inputs)[0]
    changes(network)[kind]()
    found = network(inputs)
    assert_same(found, copy.deepcopy(network).alone(inputs))
    assert any(not torch.equal(found[0][name], before[name]) for name in before)


@torch.no_grad()
def test_hooks_see_their_layer_run(path: str) -> None:
    network, seen = Network(), list[object]()
    third: nn.Module = network.layers["third"]
    network.circuit(window())
    for register in (
        lambda: third.register_forward_hook(lambda _, given, out: seen.append(out)),
        lambda: third.register_forward_pre_hook(lambda _, given: seen.append(given)),
        lambda: nn.modules.module.register_module_forward_hook(lambda module, *_: seen.append(module)),
        lambda: nn.modules.module.register_module_forward_pre_hook(lambda module, *_: seen.append(module)),
    ):
        hook = register()
        try:
            assert_same(network.circuit(window()), Network().circuit(window()))
        finally:
            hook.remove()
        assert seen
        seen.clear()
    with in_one_call(path):
        network.circuit(window())


class Doubled(nn.Module):
    def forward(self, weight: Tensor) -> Tensor:
        return 2 * weight


@pytest.mark.parametrize("ran_before", [False, True])
@torch.no_grad()
def test_weights_and_thresholds_may_be_computed(ran_before: bool) -> None:
    def pruned(module: nn.Module, name: str) -> None:
        prune.random_unstructured(module, name, amount=0.5)  # type: ignore[no-untyped-call]

    def doubled(module: nn.Module, name: str) -> None:
        parametrize.register_parametrization(module, name, Doubled())

    for change in (pruned, doubled):
        for place in ("first weight", "second weight", "second threshold", "third recurrent"):
            network = Network()
            before = network(window())[0] if ran_before else Network()(window())[0]
            name, kind = place.split()
            module: nn.Module = network.layers[name] if kind == "threshold" else network.projection(name)
            if kind == "recurrent":
                module = network.layers[name].recurrent  # type: ignore[assignment]
            torch.manual_seed(0)
            change(module, "threshold" if kind == "threshold" else "weight")
            found = network(window())
            with torch.enable_grad():
                expected = network.alone(window())
            assert_same(found, expected)
            assert any(not torch.equal(found[0][other], before[other]) for other in before), place


NAN = float("nan")


def with_one(tensor: Tensor, value: float) -> Tensor:
    broken = tensor.clone()
    broken.view(-1)[7] = value
    return broken


@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize("ran_before", [False, True])
@pytest.mark.parametrize(
    ("broken", "words"),
    [
        ({"b": lambda x: with_one(x, 0.5)}, r"spikes are 0 or 1, got 0.5 from source 12 \(step 0, batch element 0\)"),
        ({"b": lambda x: with_one(x, NAN)}, r"spikes are 0 or 1, got nan from source 12 \(step 0, batch element 0\)"),
        ({"a": lambda x: x[..., :4]}, r"a projection of 133 sources was given the spikes of 132"),
        ({"a": lambda x: x[:, :2]}, r"must agree in steps and batch, got \[\(20, 2\), \(20, 3\)\]"),
        ({"c": lambda x: x[:9]}, r"must agree in steps and batch, got \[\(9, 3\), \(20, 3\)\]"),
        ({"c": lambda x: x[:0]}, r"must agree in steps and batch, got \[\(0, 3\), \(20, 3\)\]"),
        ({"a": lambda x: x[:0]}, r"must agree in steps and batch, got \[\(0, 3\), \(20, 3\)\]"),
        ({"a": lambda x: x[0]}, r"must agree in steps and batch, got \[\(3,\), \(20, 3\)\]"),
        ({name: lambda x: x[:0] for name in SIZES}, r"at least one step, got \(0, 3, 133\)"),
        ({name: lambda x: x[0] for name in SIZES}, r"a window is of \(steps, batch, sources\) .* got \(3, 133\)"),
        ({name: lambda x: x.double() for name in SIZES}, r"torch.float32 was given spikes of torch.float64"),
    ],
)
def test_inputs_that_make_no_sense_are_refused(
    broken: dict[str, Callable[[Tensor], Tensor]], words: str, training: bool, ran_before: bool
) -> None:
    network = Network()
    with torch.set_grad_enabled(training):
        if ran_before:
            network(window())
        with pytest.raises(ValueError, match=words):
            network({name: broken.get(name, torch.clone)(x) for name, x in window().items()})
        assert_same(network(window()), Network().alone(window()))


@torch.no_grad()
def test_inputs_of_several_projections_agree_in_steps_also_if_the_first_has_some() -> None:
    """The memory of a window without steps is none that might be read."""
    layer = Layer([Dense(30, 20, generator()), Dense(4000, 20, generator())], LIF())
    for first, second in ((5, 0), (0, 5)):
        with pytest.raises(ValueError, match=r"at least one step, got \(0, 3|must agree in steps and batch"):
            Circuit(["a", "b"], {"o": (layer, ["a", "b"])})(
                {"a": torch.zeros(first, 3, 30), "b": torch.zeros(second, 3, 4000)}
            )


@pytest.mark.parametrize("training", [True, False])
def test_states_and_parameters_that_make_no_sense_are_refused(training: bool) -> None:
    network = Network()
    with torch.set_grad_enabled(training):
        for _ in range(2):
            for state, words in (
                ({"third": with_one(torch.zeros(3, 40), NAN)}, r"a potential is a finite number, got nan at \[0, 7\]"),
                ({"third": torch.zeros(2, 40)}, r"the potential is of \(2, 40\) \(batch, neurons\), .* \(3, 40\)"),
            ):
                with pytest.raises(ValueError, match=words):
                    network(window(), state=state)
            network(window())
        for place, words in (
            ("second weight", r"projection 0: weights are finite numbers, got nan at \[0, 7\]"),
            ("first weight", r"projection 0: weights are finite numbers, got nan at \[1, 3\]"),
            ("second threshold", r"threshold: weights are finite numbers, got nan at \[7\]"),
        ):
            name, kind = place.split()
            module = network.layers[name] if kind == "threshold" else network.projection(name)
            whole: Tensor = getattr(module, kind)
            setattr(module, kind, nn.Parameter(with_one(whole.detach(), NAN)))
            with pytest.raises(ValueError, match=words):
                network(window())
            setattr(module, kind, whole)
            assert_same(network(window()), Network().alone(window()))


def test_a_projection_more_is_refused_as_the_layer_does() -> None:
    network = Network()
    network.layers["output"].projections.append(Dense(4, 9, generator()))  # type: ignore[operator]
    for training in (True, False):
        with torch.set_grad_enabled(training), pytest.raises(ValueError, match="2 projections was given 1 inputs"):
            network(window())


@pytest.mark.parametrize("training", [True, False])
def test_a_missing_input_is_named(training: bool) -> None:
    inputs = window()
    del inputs["b"]
    with torch.set_grad_enabled(training), pytest.raises(ValueError, match="inputs a, b, c was not given 'b'"):
        Network()(inputs)


@pytest.mark.parametrize("training", [True, False])
def test_an_unknown_layer_is_named(training: bool) -> None:
    network = Network()
    with torch.set_grad_enabled(training):
        for given in ({"state": {"hiden": torch.zeros(2, 6)}}, {"wanted": ["hiden"]}):
            with pytest.raises(ValueError, match="has no 'hiden'"):
                network.circuit(window(), **given)


@pytest.mark.parametrize("probing", ["spikes", "bits"])
def test_a_probe_hears_every_layer(probing: str) -> None:
    network, inputs = Network(), window()
    expected, _ = network.alone(inputs)
    heard: dict[str, Tensor] = {}

    class Probe:
        def __call__(self, layer: str, spikes: Tensor) -> None:
            heard[layer] = spikes

    class BitProbe(Probe):
        def hear(self, layer: str, fired: Fired) -> None:
            heard[layer] = fired.of(torch.arange(fired.neurons)).float()
            assert fired.steps == len(heard[layer])
            assert torch.equal(fired.counts(), heard[layer].sum((0, 2)))
            assert torch.equal(fired.of(torch.tensor([1, 0])), heard[layer][:, :, [1, 0]] != 0)

    with torch.no_grad():
        spikes, _ = network.circuit(inputs, wanted=["output"], probe=BitProbe() if probing == "bits" else Probe())
    assert list(spikes) == ["output"]
    assert list(heard) == list(expected)
    assert_same([heard], [expected])


def test_wirings_that_make_no_sense_are_refused() -> None:
    layer = Layer([Dense(5, 6, generator())], LIF())
    for reads, words in (
        (["b"], "output reads 'b'; known by then: a"),
        (["output"], "output reads 'output'; known by then: a"),
        ([("a", "later")], "output reads 'later'; known by then: a"),
        ([], "output: 1 projections were given 0 readings"),
        (["a", "a"], "output: 1 projections were given 2 readings"),
        ([()], "output: a projection reads nothing"),
    ):
        with pytest.raises(ValueError, match=words):
            Circuit(["a"], {"output": (layer, reads), "later": (layer, ["a"])})


def test_a_layer_may_hide_an_input_from_those_behind() -> None:
    first, second = (on_grid(Layer([Dense(5, 5, generator(i), gain=2.0)], LIF())) for i in (0, 1))
    circuit, inputs = Circuit(["a"], {"a": (first, ["a"]), "b": (second, ["a"])}), {"a": spikes(9, 2, 5)}
    for training in (True, False):
        with torch.set_grad_enabled(training):
            hidden = first([inputs["a"]])[0]
            assert_same(circuit(inputs), ({"a": hidden, "b": second([hidden])[0]}, {}))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("training", [True, False])
def test_transforms_of_torch_are_refused_by_name(training: bool) -> None:
    network, others = Network(), window()
    with torch.set_grad_enabled(training):
        network(others)
        with pytest.raises(NotImplementedError, match=r"not under vmap, grad or others of torch\.func"):
            torch.vmap(lambda a: network({**others, "a": a})[0]["output"])(torch.zeros(2, 20, 3, 5))


@torch.no_grad()
def test_neurons_may_fire_all_the_time_and_less_again(path: str) -> None:
    g = generator()
    wiring: Wiring = {
        "wide": (on_grid(Layer([Dense(70, 300, g, gain=3.0)], LIF())), ["a"]),
        "deep": (on_grid(Layer([Dense(370, 90, g), FanIn(300, 90, 3, g)], LIF(rectify=True))), [("wide", "a"), "wide"]),
    }
    wiring["wide"][0].projections[0].weight.abs_()  # type: ignore[union-attr, operator]
    circuit = Circuit(["a"], wiring)
    for number, rate in enumerate([0.02, 1.0, 1.0, 0.02, 0.8, 0.02, 1.0, *[0.02] * 18, 1.0, 0.02]):
        inputs = {"a": spikes(20, 3, 70, rate, number)}
        expected = one_by_one(wiring, inputs, {})
        assert rate < 1 or expected[0]["wide"].mean() > 0.9
        assert_same(circuit(inputs), expected)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda network: pickle.loads(pickle.dumps(network))])
@torch.no_grad()
def test_copies_share_nothing(path: str, copied: Callable[[Network], Network]) -> None:
    network, inputs = Network(), window()
    expected = network(inputs)
    other = copied(network)
    with in_one_call(path):
        assert_same(other(inputs), expected)
    other.projection("second").weight.neg_()  # type: ignore[operator]
    changed = other(inputs)
    assert not torch.equal(changed[0]["second"], expected[0]["second"])
    assert_same(changed, other.alone(inputs))
    assert_same(network(inputs), expected)
    network.projection("first").weight.neg_()  # type: ignore[operator]
    assert not torch.equal(network(inputs)[0]["first"], expected[0]["first"])
    assert_same(other(inputs), changed)


@torch.no_grad()
def test_results_of_one_window_outlive_the_next() -> None:
    network, state = Network(), Network().at_rest(3)
    found = network(window(), state=state)
    kept = copy.deepcopy(found)
    network(window(seed=9), state=state)
    assert_same(found, kept)


def test_a_circuit_serves_several_threads_at_once() -> None:
    network = Network()
    inputs = [window(50, 4, seed=seed) for seed in range(0, 48, 3)]

    @torch.no_grad()
    def run(given: dict[str, Tensor]) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        return network(given, state=network.at_rest(4))

    alone = [run(given) for given in inputs]
    with ThreadPoolExecutor(2) as pool, threads(2):
        for found, expected in zip(pool.map(run, inputs * 2), alone * 2, strict=True):
            assert_same(found, expected)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.parametrize("ran_before", [True, False])
def test_a_forked_process_runs_on_threads_too(path: str, ran_before: bool) -> None:
    """Those that torch has started are missing there. In a process of its own, as Python warns of forks."""
    if path == "portable":
        pytest.skip("torch's own products wait for the threads that are missing")
    run_program(f"""
        import signal
        from tests.engine.test_circuit import *
        torch.set_num_threads(2)
        kernels.WORK_FOR_THREADS = 0
        torch.rand(1000, 1000).add(1).exp()  # on torch's threads
        network, inputs = Network(), window()
        with torch.no_grad():
            with engine("portable"):
                expected = network(inputs)
            if {ran_before}:
                network(inputs)
            child = os.fork()
            if child == 0:
                signal.alarm(20)
                with in_one_call("native"):
                    assert_same(network(inputs), expected)
                os._exit(0)
            assert os.waitpid(child, 0)[1] == 0
            assert_same(network(inputs), expected)
    """)
