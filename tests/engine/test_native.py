"""The native path: the reference's spikes bit for bit, its gradients, and nothing that depends on the machine.

Weights lie on a grid of 2**-12 wherever bits are compared between paths: sums of such weights are exact, so that the
order of summation, which differs between events and matrix products, does not matter.
"""

import copy
import os
import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn
from torch.nn.utils import prune

from neurorobo.codes import PopulationUniform
from neurorobo.engine import Fired, Layer, events, kernels
from neurorobo.engine.coding import decode, encode
from neurorobo.neurons import LIF, Surrogate
from neurorobo.neurons.surrogate import SurrogateShape
from neurorobo.regions.weights import to_grid
from neurorobo.synapses import Dense, FanIn, Projection
from tests.engine import reference
from tests.engine.paths import engine, instruction_sets, needs_native

pytestmark = needs_native()


@pytest.fixture(autouse=True, params=instruction_sets())
def native_path(request: pytest.FixtureRequest) -> Iterator[None]:
    with engine("native", request.param):
        yield


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def spikes(steps: int, batch: int, neurons: int, rate: float = 0.3, seed: int = 1) -> Tensor:
    return (torch.rand(steps, batch, neurons, generator=generator(seed)) < rate).float()


Sources = tuple[int | tuple[int, int], ...]
"""Of each projection the number of its sources, with the fan-in if it has one."""


def build(
    sources: Sources, neurons: int, neuron: LIF, *, recurrent: bool, thresholds: bool = False, grid: bool = True
) -> Layer:
    """A layer of about a fifth firing."""
    projections: list[Projection] = [
        FanIn(kind[0], neurons, kind[1], generator(i), gain=1.2)
        if isinstance(kind, tuple)
        else Dense(kind, neurons, generator(i), gain=1.2)
        for i, kind in enumerate(sources)
    ]
    own = Dense(neurons, neurons, generator(9), gain=0.6) if recurrent else None
    layer = Layer(projections, neuron, own, trainable_threshold=thresholds)
    with torch.no_grad():
        if layer.threshold is not None:
            layer.threshold += 0.2 * torch.rand(neurons, generator=generator(8))
        for parameter in layer.parameters():
            if grid:
                parameter.copy_(to_grid(parameter, 12))
    return layer


def plainly(layer: Layer, inputs: list[Tensor], state: Tensor) -> tuple[Tensor, Tensor]:
    """Run a layer through the reference."""
    current = sum((x @ p.matrix().t() for p, x in zip(layer.projections, inputs, strict=True)), torch.zeros(()))
    threshold = torch.tensor(layer.neuron.threshold).to(state) if layer.threshold is None else layer.threshold
    recurrent = None if layer.recurrent is None else layer.recurrent.matrix()
    return reference.run_window(current, state, layer.neuron, threshold, recurrent)


KINDS: dict[str, tuple[Sources, bool]] = {
    "dense": ((70,), False),
    "several": ((70, 130, 5), False),
    "recurrent": ((50,), True),
    "fan-in": (((70, 4),), False),
    "mixed": ((64, (129, 5)), False),
    "mixed-recurrent": (((30, 2), 20), True),
}
kinds = pytest.mark.parametrize("kind", KINDS)


def problem(kind: str, steps: int, batch: int, rate: float = 0.3) -> tuple[list[Tensor], Tensor]:
    sources = [s[0] if isinstance(s, tuple) else s for s in KINDS[kind][0]]
    inputs = [spikes(steps, batch, n, rate, seed) for seed, n in enumerate(sources)]
    return inputs, to_grid(torch.rand(batch, 143, generator=generator(7)), 12)  # some fired just before


@kinds
@pytest.mark.parametrize("thresholds", [False, True], ids=["", "thresholds"])
@pytest.mark.parametrize("rectify", [False, True], ids=["", "rectified"])
@pytest.mark.parametrize(("steps", "batch"), [(1, 1), (1, 100), (2, 3), (50, 1), (64, 2), (65, 1), (130, 3)])
@torch.no_grad()
def test_spikes_and_potentials_are_those_of_the_reference_bit_for_bit(
    kind: str, thresholds: bool, rectify: bool, steps: int, batch: int
) -> None:
    sources, recurrent = KINDS[kind]
    layer = build(sources, 143, LIF(rectify=rectify), recurrent=recurrent, thresholds=thresholds)
    inputs, state = problem(kind, steps, batch)
    found, last = layer(inputs, state)
    expected, expected_last = plainly(layer, inputs, state)
    assert torch.equal(found, expected)
    assert torch.equal(last, expected_last)
    assert steps == 1 or 0.05 < found.mean() < 0.95


@kinds
@pytest.mark.parametrize("rate", [0.0, 0.02, 0.65, 0.75, 1.0])
@torch.no_grad()
def test_spikes_do_not_depend_on_how_densely_the_sources_fire(kind: str, rate: float) -> None:
    """Where most of them do, a matrix product takes the place of the events."""
    sources, recurrent = KINDS[kind]
    layer = build(sources, 143, LIF(), recurrent=recurrent)
    inputs, state = problem(kind, 20, 5, rate)
    found, last = layer(inputs, state)
    expected, expected_last = plainly(layer, inputs, state)
    assert torch.equal(found, expected)
    assert torch.equal(last, expected_last)


def gradients(
    run: Callable[[Layer, list[Tensor], Tensor], tuple[Tensor, Tensor]],
    layer: Layer,
    inputs: list[Tensor],
    state: Tensor,
) -> dict[str, Tensor]:
    """Return those of a random loss in all that a layer's window depends on."""
    inputs = [x.clone().requires_grad_() for x in inputs]
    state = state.clone().requires_grad_()
    layer.zero_grad()
    fired, last = run(layer, inputs, state)
    loss = (fired * torch.randn(fired.shape, generator=generator(3)).to(fired)).sum()
    (loss + (last * torch.randn(last.shape, generator=generator(4)).to(last)).sum()).backward()
    leaves = {**dict(layer.named_parameters()), "state": state, **{f"input {i}": x for i, x in enumerate(inputs)}}
    return {name: leaf.grad.clone() for name, leaf in leaves.items() if leaf.grad is not None}


def assert_close(found: dict[str, Tensor], expected: dict[str, Tensor], tolerance: float = 1e-5) -> None:
    assert found.keys() == expected.keys()
    for name, gradient in found.items():
        scale = expected[name].abs().max()
        assert scale > 0, name
        assert (gradient - expected[name]).abs().max() <= tolerance * scale, name


@kinds
@pytest.mark.parametrize("rectify", [False, True], ids=["", "rectified"])
@pytest.mark.parametrize("reset_gradient", ["full", "detached"])
@pytest.mark.parametrize("shape", ["rectangular", "triangular", "arctan", "fast_sigmoid"])
def test_gradients_are_those_of_autograd(
    kind: str, rectify: bool, reset_gradient: Literal["full", "detached"], shape: SurrogateShape
) -> None:
    """Against double precision. The rectangle is not continuous: a potential that rounding carries over its edge gains
    or loses the whole derivative. Its half width is therefore off the grid that the potentials are near to."""
    sources, recurrent = KINDS[kind]
    neuron = LIF(surrogate=Surrogate(shape, 0.9001), reset_gradient=reset_gradient, rectify=rectify)
    layer = build(sources, 143, neuron, recurrent=recurrent, thresholds=True)
    inputs, state = problem(kind, 20, 4)
    expected = gradients(plainly, copy.deepcopy(layer).double(), [x.double() for x in inputs], state.double())
    assert_close(gradients(Layer.__call__, layer, inputs, state), {k: v.float() for k, v in expected.items()})


@pytest.mark.parametrize("rate", [0.1, 0.9])
@pytest.mark.parametrize(("steps", "batch"), [(1, 1), (3, 50), (70, 1)])
def test_gradients_of_windows_of_all_lengths_and_densities(rate: float, steps: int, batch: int) -> None:
    layer = build((70, (40, 3)), 143, LIF(surrogate=Surrogate("arctan")), recurrent=True)
    inputs, state = [spikes(steps, batch, 70, rate), spikes(steps, batch, 40, rate)], torch.rand(batch, 143)
    expected = gradients(plainly, copy.deepcopy(layer).double(), [x.double() for x in inputs], state.double())
    assert_close(gradients(Layer.__call__, layer, inputs, state), {k: v.float() for k, v in expected.items()})


def test_only_what_is_asked_for_gets_a_gradient() -> None:
    layer = build((70, (40, 3)), 143, LIF(), recurrent=True, thresholds=True)
    wanted = layer.projections[1].weight
    for parameter in layer.parameters():
        parameter.requires_grad_(parameter is wanted)
    inputs, state = [spikes(9, 2, 70), spikes(9, 2, 40)], torch.zeros(2, 143)
    layer(inputs, state)[1].sum().backward()  # of the last potential alone
    assert [name for name, parameter in layer.named_parameters() if parameter.grad is not None] == [
        "projections.1.weight"
    ]


@kinds
@pytest.mark.parametrize("pieces", [[1] * 130, [64, 66], [3, 127]], ids=["streaming", "halves", "uneven"])
@torch.no_grad()
def test_a_window_in_pieces_is_the_whole_window_bit_for_bit(kind: str, pieces: list[int]) -> None:
    sources, recurrent = KINDS[kind]
    layer = build(sources, 143, LIF(rectify=True), recurrent=recurrent)
    inputs, state = problem(kind, 130, 2)
    whole, last = layer(inputs, state)
    parts = []
    for piece in zip(*(x.split(pieces) for x in inputs), strict=True):
        fired, state = layer(list(piece), state)
        parts.append(fired)
    assert torch.equal(torch.cat(parts), whole)
    assert torch.equal(state, last)


@kinds
def test_neither_threads_nor_the_instruction_set_change_a_bit(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of spikes, potentials and gradients; off the grid, where a single other order of summation would show."""
    sources, recurrent = KINDS[kind]
    layer = build(sources, 143, LIF(surrogate=Surrogate("arctan")), recurrent=recurrent, thresholds=True, grid=False)
    inputs, state = problem(kind, 66, 40)
    monkeypatch.setattr(kernels, "WORK_FOR_THREADS", 0)
    found = []
    for instructions in instruction_sets():
        for count in (1, 3):
            with engine("native", instructions):
                # torch's own products may depend on the number of threads, so the kernels alone get more
                monkeypatch.setattr(torch, "get_num_threads", lambda count=count: count)
                layer = copy.deepcopy(layer)  # the tiles of another build are of another width
                with torch.no_grad():
                    results = dict(zip(("spikes", "last"), layer(inputs, state), strict=True))
                found.append(results | gradients(Layer.__call__, layer, inputs, state))
    assert len(found) >= 2
    for other in found[1:]:
        for name, tensor in found[0].items():
            assert torch.equal(tensor, other[name]), name


def packed(weight: Tensor) -> tuple[int, float]:
    """How many bits count each weight, and what they count."""
    native = kernels.kernels()
    assert native is not None
    found = native.pack_weights(weight, narrow=True)
    return found.bits, found.unit


def test_weights_are_packed_narrow_only_if_all_of_them_are_small_multiples_of_one_number() -> None:
    weight = torch.randint(-127, 128, (143, 300), generator=generator()).float()
    weight[7, 8:10] = torch.tensor([1.0, 127.0])
    for scale in (2.0**-9, 1.0, 2.0**60):
        assert packed(weight * scale) == (8, scale)
        assert packed(weight * scale * 200) == (16, scale * 8)
    assert packed(weight / 3) == (32, 0)
    for value, expected in (
        (128.0, (16, 1)),
        (-32767.0, (16, 1)),
        (0.5, (16, 0.5)),
        (2.0**-8, (16, 2.0**-8)),
        (2.0**-9, (32, 0)),
        (32768.0, (32, 0)),
        (1e-30, (32, 0)),
        (1e30, (32, 0)),
    ):
        weight[100, 200] = value
        assert packed(weight) == expected, value
    assert packed(torch.zeros(3, 4)) == (32, 0)
    assert packed(torch.full((3, 4), 40000.0)) == (16, 64)
    assert packed(torch.full((3, 4), 40960.0)) == (8, 8192)


def test_weights_whose_sum_could_leave_the_bits_of_a_float_are_not_packed_narrow() -> None:
    weight = torch.full((2, 2**24 // 127), 127.0)
    weight[0] = 0
    weight[:, 0] = 1
    assert packed(weight) == (8, 1)
    assert packed(torch.cat([weight, weight[:, -3:]], dim=1)) == (32, 0)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("sources", [1, 64, 65, 127, 128, 129, 255, 256, 257, 500])
@torch.no_grad()
def test_no_sum_of_narrow_weights_runs_over(sources: int, bits: int) -> None:
    """Here all of the largest, of either sign and mixed."""
    signs = torch.tensor([[1.0], [-1.0]]).repeat(72, 1)[:143].expand(143, sources).clone()
    signs[::3, ::2] *= -1
    layer = Layer([Dense(sources, 143, generator())], LIF(threshold=1.0, decay=0.5))
    layer.projections[0].weight.copy_(signs * (2 ** (bits - 1) - 1) / 4096)
    layer.projections[0].weight[0, 0] = 1 / 4096
    assert packed(layer.projections[0].weight) == (bits, 2.0**-12)
    for rate, steps in ((1.0, 70), (0.6, 70), (1.0, 1)):
        inputs, state = [spikes(steps, 2, sources, rate)], torch.zeros(2, 143)
        for instructions in instruction_sets():
            with engine("native", instructions):
                found, last = copy.deepcopy(layer)(inputs, state)
            expected, expected_last = plainly(layer, inputs, state)
            assert torch.equal(found, expected)
            assert torch.equal(last, expected_last)


def test_what_is_packed_depends_on_the_weights_and_not_on_what_ran_before() -> None:
    """One weight of a mixed layer is off the grid of the others, so that the order of summation would show."""
    layer = Layer([Dense(1, 3, generator()), Dense(256, 3, generator())], LIF(threshold=1e9))
    with torch.no_grad():
        layer.projections[0].weight.fill_(0.1)
        layer.projections[1].weight.copy_(2.0**-34 * torch.randint(-127, 128, (3, 256), generator=generator()))
    inputs, state = [torch.ones(1, 1, 1), spikes(1, 1, 256, 0.6)], torch.zeros(1, 3)

    def run(train: bool) -> Tensor:
        with torch.set_grad_enabled(train):
            return layer(inputs, state)[1].detach()

    first, trained, again, retrained = run(False), run(True), run(False), run(True)
    assert torch.equal(first, again)
    assert torch.equal(trained, retrained)
    assert not torch.equal(first, trained)  # else this test shows nothing


@pytest.mark.parametrize("kind", [torch.float64, torch.bfloat16])
def test_the_type_that_torch_takes_by_default_is_none_of_the_kernels_business(kind: torch.dtype) -> None:
    layer = build((70, (30, 4)), 143, LIF(), recurrent=True)
    inputs, state = [spikes(50, 2, 70), spikes(50, 2, 30)], torch.zeros(2, 143)
    expected = layer(inputs, state)[0]
    share = torch.rand(expected.shape, generator=generator(3))
    (expected * share).sum().backward()
    code, values = PopulationUniform(10, 0.0, 1.0), torch.rand(3, 2)
    window = encode(code, values, 50)
    numbers = decode(code, window)
    events.number_tensor.cache_clear()
    before = torch.get_default_dtype()
    torch.set_default_dtype(kind)
    try:
        fresh = copy.deepcopy(layer)
        with torch.no_grad():
            assert torch.equal(fresh(inputs, state)[0], expected)
            assert torch.equal(fresh(inputs)[0], expected)
        fresh.zero_grad()
        (fresh(inputs, state)[0] * share).sum().backward()
        for found, wanted in zip(fresh.parameters(), layer.parameters(), strict=True):
            assert torch.equal(found.grad, wanted.grad)
        assert torch.equal(encode(code, values, 50), window)
        assert torch.equal(decode(code, window), numbers)
        assert fresh.at_rest(2).dtype is torch.float32
    finally:
        torch.set_default_dtype(before)


@torch.no_grad()
def test_a_window_in_large_pages_is_that_of_its_parts() -> None:
    layer = build((20,), 3000, LIF(), recurrent=False)
    inputs, state = spikes(50, 40, 20), torch.zeros(40, 3000)
    found, last = layer([inputs], state)
    assert found.nbytes > 2 * kernels.LARGE_BYTES
    for part in (slice(0, 3), slice(37, 40)):
        fired, after = layer([inputs[:, part]], state[part])
        assert torch.equal(found[:, part], fired)
        assert torch.equal(last[part], after)


def test_an_index_is_looked_at_when_something_else_computes_the_weights() -> None:
    layer = build(((70, 4),), 143, LIF(), recurrent=False)
    inputs, state = [spikes(9, 2, 70)], torch.zeros(2, 143)
    prune.random_unstructured(layer.projections[0], "weight", amount=0.5)
    assert torch.equal(layer(inputs, state)[0], plainly(layer, inputs, state)[0])
    layer.projections[0].source_index[3, 2] = 2**40
    with pytest.raises(ValueError, match=r"source_index lies in 0\.\.69, got 1099511627776 at \[3, 2\]"):
        layer(inputs, state)


@torch.no_grad()
def test_one_layer_serves_several_threads_at_once() -> None:
    layer = build((300,), 143, LIF(), recurrent=True)
    inputs = [spikes(50, 4, 300, seed=seed) for seed in range(16)]
    alone = [layer([x], torch.zeros(4, 143))[0] for x in inputs]

    @torch.no_grad()
    def run(x: Tensor) -> Tensor:
        return layer([x], torch.zeros(4, 143))[0]

    with ThreadPoolExecutor(4) as pool:
        for found, expected in zip(pool.map(run, inputs), alone, strict=True):
            assert torch.equal(found, expected)


def test_inputs_may_be_views_and_state_and_inputs_are_left_alone() -> None:
    layer = build((70,), 143, LIF(), recurrent=False)
    wide = spikes(3, 20, 140).transpose(0, 1)
    state = torch.rand(143, 3).t()
    for view in (wide[..., 70:], wide[..., ::2], wide[:1, :, :70].expand(20, 3, 70), wide.flip(2)[..., :70]):
        before, state_before = view.clone(), state.clone()
        found = layer([view], state)
        expected = plainly(layer, [view.contiguous()], state)
        assert torch.equal(found[0], expected[0])
        assert torch.equal(found[1], expected[1])
        assert torch.equal(view, before)
        assert torch.equal(state, state_before)


@pytest.mark.parametrize("recurrent", [False, True])
def test_windows_run_again_without_gradients_are_those_with_gradients(recurrent: bool) -> None:
    layer = build((70, (30, 4)), 143, LIF(), recurrent=recurrent, thresholds=True)
    state = torch.rand(2, 143, generator=generator(3))
    windows = [(50, 2, 0.2), (50, 2, 0.3), (50, 2, 0.95), (50, 2, 0.0), (9, 2, 0.2), (1, 1, 0.2), (50, 2, 0.2)]
    for steps, batch, rate in windows:
        inputs = [spikes(steps, batch, sources, rate=rate, seed=sources) for sources in (70, 30)]
        expected = layer(inputs, state[:batch])
        for _ in range(2):
            with torch.no_grad():
                found = layer(inputs, state[:batch])
            assert torch.equal(found[0], expected[0])
            assert torch.equal(found[1], expected[1])


@torch.no_grad()
def test_every_change_of_the_weights_is_noticed() -> None:
    layer = build((70,), 143, LIF(), recurrent=True)
    inputs, state = [spikes(30, 2, 70)], torch.zeros(2, 143)

    def fused_adam() -> None:
        optimiser = torch.optim.Adam(layer.parameters(), lr=0.1, fused=True)
        for parameter in layer.parameters():
            parameter.grad = torch.randn(parameter.shape, generator=generator(5))
        optimiser.step()

    def replaced() -> None:
        layer.projections[0].weight = nn.Parameter(torch.randn(143, 70, generator=generator(6)) * 0.2)

    changes: list[Callable[[], object]] = [
        fused_adam,
        lambda: layer.projections[0].weight.mul_(-1),
        lambda: layer.load_state_dict({name: p.roll(1, 0) for name, p in layer.state_dict().items()}),
        replaced,
        lambda: layer.recurrent.weight.zero_(),
        lambda: setattr(layer, "recurrent", Dense(143, 143, generator(8), gain=2.0)),
        lambda: layer.projections.__setitem__(0, FanIn(70, 143, 4, generator(7), gain=2.0)),
        lambda: layer.projections[0].source_index.copy_(layer.projections[0].source_index.flip(0)),
        lambda: setattr(layer.projections[0], "source_index", layer.projections[0].source_index.roll(1, 0)),
        lambda: setattr(layer, "neuron", LIF(threshold=0.9)),
        lambda: setattr(layer, "threshold", nn.Parameter(torch.full((143,), 0.3))),
        lambda: setattr(layer, "threshold", None),
    ]
    before = layer(inputs, state)[0]
    for change in changes:
        change()
        for parameter in layer.parameters():
            parameter.copy_(to_grid(parameter, 12)) if change is not fused_adam else None
        found = layer(inputs, state)[0]
        fresh = copy.deepcopy(layer)
        assert torch.equal(found, fresh(inputs, state)[0])
        assert not torch.equal(found, before)
        before = found
    assert torch.equal(pickle.loads(pickle.dumps(layer))(inputs, state)[0], before)
    assert "_checked" not in str(layer.state_dict().keys())


def test_a_change_of_weights_between_the_ways_is_refused_as_autograd_does() -> None:
    layer = build((70,), 143, LIF(), recurrent=False)
    fired, _ = layer([spikes(9, 2, 70).requires_grad_()], torch.zeros(2, 143))
    with torch.no_grad():
        layer.projections[0].weight.add_(1)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        fired.sum().backward()


def arranged(tensor: Tensor, memory: str) -> Tensor:
    """Return equal numbers that lie otherwise in memory; a vector may then begin at any of them."""
    *rest, columns = tensor.shape
    if memory == "transposed":
        return tensor.transpose(0, 1).contiguous().transpose(0, 1)
    if memory == "every other":
        return torch.stack([tensor, tensor], dim=-1).flatten(-2)[..., ::2]
    if memory == "cut out":
        return torch.cat([tensor.new_ones(*rest, 3), tensor, tensor.new_ones(*rest, 2)], dim=-1)[..., 3 : 3 + columns]
    return tensor.contiguous()


MEMORIES = ("contiguous", "transposed", "every other", "cut out")


@pytest.mark.parametrize("memory", MEMORIES)
def test_gradients_may_come_in_any_memory(memory: str) -> None:
    layer = build((70, (40, 3)), 143, LIF(surrogate=Surrogate("arctan")), recurrent=True)
    leaves = list(layer.parameters())
    of_spikes, of_last = torch.randn(9, 4, 143, generator=generator(3)), torch.randn(4, 143, generator=generator(4))
    found = []
    for kind in ("contiguous", memory):
        outputs = layer([spikes(9, 4, 70), spikes(9, 4, 40)], torch.zeros(4, 143))
        found.append(torch.autograd.grad(outputs, leaves, [arranged(of_spikes, kind), arranged(of_last, kind)]))
    for expected, gradient in zip(*found, strict=True):
        assert expected.abs().max() > 0
        assert torch.equal(gradient, expected)


def test_an_index_may_lie_anywhere_in_memory() -> None:
    layer = build(((70, 4),), 143, LIF(surrogate=Surrogate("arctan")), recurrent=False)
    projection, found = layer.projections[0], []
    for memory in ("contiguous", "transposed"):
        projection.source_index = arranged(projection.source_index, memory)
        fired, _ = layer([spikes(9, 4, 70)], torch.zeros(4, 143))
        found.append((fired.detach(), *torch.autograd.grad(fired.sum(), list(layer.parameters()))))
    for expected, same in zip(*found, strict=True):
        assert expected.abs().max() > 0
        assert torch.equal(same, expected)


@dataclass(frozen=True)
class Shape:
    steps: int
    batch: int
    neurons: int
    sources: Sources
    recurrent: bool
    thresholds: bool
    rectify: bool
    memory: str


EDGES = [edge + beside for edge in (32, 64, 128, 256) for beside in (-1, 0, 1)]
"""Of words, and of the tiles of all instruction sets."""


@st.composite
def shapes(draw: st.DrawFn) -> Shape:
    sources = []
    for _ in range(draw(st.integers(1, 3))):
        count = draw(st.integers(1, 140) | st.sampled_from(EDGES))
        sources.append((count, draw(st.integers(1, min(count, 6)))) if draw(st.booleans()) else count)
    return Shape(
        draw(st.integers(1, 140) | st.sampled_from(EDGES[:9])),
        draw(st.integers(0, 20)),
        draw(st.integers(1, 300) | st.sampled_from(EDGES)),
        tuple(sources),
        draw(st.booleans()),
        draw(st.booleans()),
        draw(st.booleans()),
        draw(st.sampled_from(MEMORIES)),
    )


@given(shape=shapes(), rate=st.sampled_from([0.0, 0.1, 0.5, 0.9]), bits=st.sampled_from([8, 16, 32]))
@settings(max_examples=int(os.environ.get("NEUROROBO_FUZZ", "40")))
def test_all_shapes_agree_with_the_reference(shape: Shape, rate: float, bits: int) -> None:
    neuron = LIF(surrogate=Surrogate("arctan"), rectify=shape.rectify)
    layer = build(shape.sources, shape.neurons, neuron, recurrent=shape.recurrent, thresholds=shape.thresholds)
    with torch.no_grad():
        if bits == 8:
            for parameter in layer.parameters():
                parameter.copy_(to_grid(parameter, 4))
        if bits == 32:
            layer.projections[0].weight.view(-1)[0] += 16
    sources = [s[0] if isinstance(s, tuple) else s for s in shape.sources]
    inputs = [spikes(shape.steps, shape.batch, n, rate, seed) for seed, n in enumerate(sources)]
    state = to_grid(torch.rand(shape.batch, shape.neurons, generator=generator(2)), 12)

    def run(layer: Layer, inputs: list[Tensor], state: Tensor) -> tuple[Tensor, Tensor]:
        return layer([arranged(x, shape.memory) for x in inputs], arranged(state, shape.memory))

    with torch.no_grad():
        found, last = run(layer, inputs, state)
        expected, expected_last = plainly(layer, inputs, state)
    assert torch.equal(found, expected)
    assert torch.equal(last, expected_last)
    if shape.batch == 0:
        return
    # Both in single precision: in double, a potential that lies next to the threshold may fire, and a rectified one
    # that has decayed to zero has not yet done so.
    theirs = gradients(plainly, layer, inputs, state)
    for name, gradient in gradients(run, layer, inputs, state).items():
        assert (gradient - theirs[name]).abs().max() <= 1e-4 * theirs[name].abs().max() + 1e-9, name


def fired_of(given: Tensor) -> Fired:
    native = kernels.kernels()
    assert native is not None
    return Fired(native, native.pack_spikes(given).words, len(given), given.shape[2])


@pytest.mark.parametrize(
    ("neurons", "words"),
    [
        (torch.tensor([0, 100]), r"numbered 0\.\.99, got 100 at 1"),
        (torch.tensor([-1]), r"numbered 0\.\.99, got -1 at 0"),
        (torch.tensor([2**40]), r"numbered 0\.\.99"),
        (torch.tensor([0, 1], dtype=torch.int32), r"torch\.int64 on the CPU, got torch\.int32"),
        (torch.tensor([[0, 1]]), r"got torch\.int64 of \(1, 2\)"),
        (torch.tensor([0], device="meta"), "on meta"),
    ],
    ids=str,
)
def test_neurons_that_a_layer_does_not_have_are_not_picked(neurons: Tensor, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        fired_of(spikes(5, 3, 100)).of(neurons)


def test_some_neurons_are_picked_whatever_their_strides() -> None:
    given, even = spikes(5, 3, 100), torch.arange(100)[::2]
    assert torch.equal(fired_of(given).of(even), given[:, :, even] != 0)
    assert fired_of(given).of(even[:0]).shape == (5, 3, 0)
