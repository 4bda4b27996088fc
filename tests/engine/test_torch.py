"""What torch offers around a module works on a layer, or is refused by name; on both paths."""

import copy
import io
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import safetensors.torch
import torch
from torch import Tensor, nn
from torch.autograd import forward_ad
from torch.nn.utils import parametrize
from torch.utils.checkpoint import checkpoint

from neurorobo.engine import Layer
from neurorobo.synapses import Dense
from tests.engine.test_paths import INPUTS, generator, layer

STATE = torch.zeros(3, 20)
DENSE = [torch.ones_like(x) for x in INPUTS]  # so many spikes that a matrix product is faster


def gradients(run: Callable[[list[Tensor], Tensor], tuple[Tensor, Tensor]], built: Layer) -> list[Tensor]:
    """Return those of the spikes and the last potential in all that a layer's window depends on."""
    inputs, state = [x.clone().requires_grad_() for x in INPUTS], STATE.clone().requires_grad_()
    fired, last = run(inputs, state)
    weights = torch.randn(fired.shape, generator=generator(3))
    return list(torch.autograd.grad((fired * weights).sum() + last.sum(), [*built.parameters(), *inputs, state]))


def test_weights_may_be_given_with_the_call(path: str) -> None:
    built, other = layer(), layer()
    with torch.no_grad():
        for parameter in other.parameters():
            parameter.copy_(parameter.roll(1, 0))
    given = {name: parameter.detach().clone().requires_grad_() for name, parameter in other.named_parameters()}
    expected, _ = other(INPUTS, STATE)
    expected.sum().backward()
    found, _ = torch.func.functional_call(built, given, (INPUTS, STATE))
    found.sum().backward()
    assert torch.equal(found, expected)
    assert not torch.equal(found, built(INPUTS, STATE)[0])
    for name, parameter in other.named_parameters():
        assert torch.equal(given[name].grad, parameter.grad)  # type: ignore[arg-type]
    assert all(parameter.grad is None for parameter in built.parameters())
    with torch.no_grad():  # where windows are prepared, and run again
        for _ in range(2):
            assert torch.equal(built(INPUTS, STATE)[0], layer()(INPUTS, STATE)[0])
            assert torch.equal(torch.func.functional_call(built, given, (INPUTS, STATE))[0], expected)


def test_weights_of_another_shape_are_refused_also_with_the_call(path: str) -> None:
    for name, shape, words in [
        ("projections.0.weight", (20, 29), r"projection 0: .* 30 sources to 20 neurons .* \(20, 30\), got \(20, 29\)"),
        ("projections.1.weight", (20, 2), r"projection 1: .* 12 sources to 20 neurons .* \(20, 3\), got \(20, 2\)"),
        ("recurrent.weight", (19, 19), r"recurrent: .* 20 sources to 20 neurons .* \(20, 20\), got \(19, 19\)"),
        ("threshold", (19,), r"threshold: one for each of 20 neurons, got a shape of \(19,\)"),
    ]:
        for training in (True, False):
            with torch.set_grad_enabled(training), pytest.raises(ValueError, match=words):
                torch.func.functional_call(layer(), {name: torch.zeros(shape)}, (INPUTS, STATE))


def test_a_recurrent_projection_of_another_size_is_refused(path: str) -> None:
    built = layer()
    built.recurrent = Dense(30, 20, generator())
    with pytest.raises(ValueError, match=r"recurrent: .* \(20, 20\), got \(20, 30\)"):
        built(INPUTS, STATE)


warns_of_itself = pytest.mark.filterwarnings("ignore::DeprecationWarning")
"""What torch calls of its own, and deprecates."""


@warns_of_itself
@pytest.mark.parametrize("training", [True, False])
def test_derivatives_in_forward_mode_are_refused_by_name(path: str, training: bool) -> None:
    with torch.set_grad_enabled(training), forward_ad.dual_level():
        state = forward_ad.make_dual(STATE, torch.ones_like(STATE))
        with pytest.raises(NotImplementedError, match="no derivatives in forward mode"):
            layer()(INPUTS, state)


@warns_of_itself
@pytest.mark.parametrize("trace", [torch.jit.trace, torch.export.export])
def test_tracing_and_exporting_are_refused_by_name(path: str, trace: Callable[..., object]) -> None:
    with pytest.raises(NotImplementedError, match="neither traced nor exported"):
        trace(layer(), (INPUTS, STATE))


@warns_of_itself
def test_scripting_is_refused_by_torch_which_names_the_module(path: str) -> None:
    with pytest.raises(RuntimeError, match=r"Layer|Dense"):
        torch.jit.script(layer())


def run(program: str) -> None:
    """Run a program in a process of its own, on the path of the test."""
    lines = program.splitlines()
    indent = min(len(line) - len(line.lstrip()) for line in lines if line.strip())
    head = "import torch\nfrom tests.engine.test_torch import *\n"
    command = [sys.executable, "-c", head + "\n".join(line[indent:] for line in lines)]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_a_compiled_layer_is_left_as_it_is_however_often_its_window_changes(path: str) -> None:
    """More often than torch.compile is willing to compile; and the layer is set apart once, not with each call."""
    run("""
        built = layer()
        compiled = torch.compile(built, backend="eager")
        apart = set()
        for steps in range(1, 12):
            inputs = [x.repeat(2, 1, 1)[:steps] for x in INPUTS]
            for grad in (True, False):
                with torch.set_grad_enabled(grad):
                    found, expected = compiled(inputs, STATE), built(inputs, STATE)
                assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))
            apart.add(Layer._run_apart)
        assert len(apart) == 1 and None not in apart
    """)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize("inputs", [INPUTS, DENSE], ids=["sparse", "dense"])
@pytest.mark.parametrize("training", [True, False])
def test_autocast_does_not_reach_into_a_layer(
    path: str, dtype: torch.dtype, inputs: list[Tensor], training: bool
) -> None:
    built = layer()
    with torch.set_grad_enabled(training):
        expected = built(inputs, STATE)
        with torch.autocast("cpu", dtype=dtype):
            found = built(inputs, STATE)
            assert (STATE @ STATE.t()).dtype is dtype  # it is on
    for tensor, theirs in zip(found, expected, strict=True):
        assert tensor.dtype is torch.float32
        assert torch.equal(tensor, theirs)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_nor_does_autocast_reach_into_the_way_back(path: str, dtype: torch.dtype) -> None:
    def under_autocast(inputs: list[Tensor], state: Tensor) -> tuple[Tensor, Tensor]:
        fired, last = built(inputs, state)
        autocast.__enter__()
        return fired, last

    built, autocast = layer(), torch.autocast("cpu", dtype=dtype)
    expected = gradients(built, built)
    found = gradients(under_autocast, built)
    autocast.__exit__(None, None, None)
    tolerance = 0.0 if path == "native" else 0.02  # the product before the portable scan is torch's own
    for gradient, theirs in zip(found, expected, strict=True):
        assert (gradient - theirs).abs().max() <= tolerance * theirs.abs().max()


@warns_of_itself
def test_gradients_in_batches_are_refused_by_name(path: str) -> None:
    state = STATE.clone().requires_grad_()
    _, last = layer()(INPUTS, state)
    with pytest.raises(NotImplementedError, match=r"not as batches \(is_grads_batched=True\)"):
        torch.autograd.grad(last, state, torch.ones(2, *last.shape), is_grads_batched=True)


@pytest.mark.parametrize("use_reentrant", [False, True])
def test_a_layer_may_be_run_again_instead_of_kept(path: str, use_reentrant: bool) -> None:
    """torch.utils.checkpoint."""
    built = layer()

    def again(inputs: list[Tensor], state: Tensor) -> tuple[Tensor, Tensor]:
        return checkpoint(lambda a, b, c: built([a, b], c), *inputs, state, use_reentrant=use_reentrant)

    def backward(run: Callable[[list[Tensor], Tensor], tuple[Tensor, Tensor]]) -> list[Tensor]:
        built.zero_grad()
        fired, last = run([x.clone().requires_grad_() for x in INPUTS], STATE)
        (fired.sum() + last.sum()).backward()
        return [parameter.grad.clone() for parameter in built.parameters()]  # type: ignore[union-attr]

    for found, expected in zip(backward(again), backward(built), strict=True):
        assert expected.abs().max() > 0
        assert torch.equal(found, expected)


def test_weights_go_through_files_and_copies(path: str, tmp_path: Path) -> None:
    built = layer()
    with torch.no_grad():
        expected, _ = built(INPUTS, STATE)  # what it remembers of its weights is not to get in the way

    def through_torch() -> Layer:
        memory = io.BytesIO()
        torch.save(built.state_dict(), memory)
        memory.seek(0)
        return loaded(torch.load(memory, weights_only=True))

    def through_safetensors() -> Layer:
        safetensors.torch.save_file(built.state_dict(), tmp_path / "weights.safetensors")
        return loaded(safetensors.torch.load_file(tmp_path / "weights.safetensors"))

    def loaded(weights: dict[str, Tensor]) -> Layer:
        other = layer()
        with torch.no_grad():
            for tensor in other.state_dict().values():
                tensor.zero_()
            if other.threshold is not None:
                other.threshold += 1
            assert not other(INPUTS, STATE)[0].any()
        other.load_state_dict(weights)
        return other

    def as_a_module() -> Layer:
        memory = io.BytesIO()
        torch.save(built, memory)
        memory.seek(0)
        module: Layer = torch.load(memory, weights_only=False)
        return module

    for same in (through_torch(), through_safetensors(), as_a_module(), copy.deepcopy(built)):
        for training in (True, False):
            with torch.set_grad_enabled(training):
                assert torch.equal(same(INPUTS, STATE)[0], expected)
        with torch.no_grad():
            same.projections[0].weight.neg_()  # type: ignore[union-attr, operator]
            assert not torch.equal(same(INPUTS, STATE)[0], expected)  # it shares nothing with the one it came from
            assert torch.equal(built(INPUTS, STATE)[0], expected)


@pytest.mark.parametrize("dtype", [torch.float64, torch.bfloat16, torch.float16])
def test_a_layer_moves_to_other_types_of_numbers_and_back(path: str, dtype: torch.dtype) -> None:
    built = layer()
    with torch.no_grad():
        expected, _ = built(INPUTS, STATE)
        there, state = built.to(dtype)([x.to(dtype) for x in INPUTS], built.at_rest(3))
        assert there.dtype is state.dtype is dtype
        assert dtype is not torch.float64 or torch.equal(there.float(), expected)
        if dtype is torch.float64:
            assert torch.equal(built.to(torch.float32)(INPUTS, STATE)[0], expected)


def test_computed_weights_are_trained(path: str) -> None:
    """torch.nn.utils.parametrize."""

    class Doubled(nn.Module):
        def forward(self, weight: Tensor) -> Tensor:
            return 2 * weight

    built, expected = layer(), layer()
    parametrize.register_parametrization(built.projections[0], "weight", Doubled())
    with torch.no_grad():
        expected.projections[0].weight.mul_(2)  # type: ignore[union-attr, operator]
    found, _ = built(INPUTS, STATE)
    assert torch.equal(found, expected(INPUTS, STATE)[0])
    found.sum().backward()
    assert built.projections[0].parametrizations.weight.original.grad.any()  # type: ignore[union-attr]
    with torch.no_grad():
        assert torch.equal(built(INPUTS, STATE)[0], found)


def test_spikes_of_inference_mode_may_feed_a_layer_that_is_not_trained(path: str) -> None:
    built, after = layer(), Layer([Dense(20, 7, generator())], layer().neuron)
    with torch.inference_mode():
        fired, state = built(INPUTS, STATE)
    with torch.no_grad():
        expected, _ = after([fired.clone()], after.at_rest(3))
        assert torch.equal(after([fired], after.at_rest(3))[0], expected)
        assert torch.equal(built(INPUTS, state)[0], built(INPUTS, state.clone())[0])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_process_runs_and_trains_what_its_parent_made(path: str) -> None:
    """In a process of its own, as Python warns of forks beside threads."""
    run("""
        built = layer()
        expected = gradients(built, built)
        with torch.no_grad():
            fired, _ = built(INPUTS, STATE)
        child = os.fork()
        if child == 0:
            same = all(torch.equal(a, b) for a, b in zip(gradients(built, built), expected, strict=True))
            with torch.no_grad():
                same &= torch.equal(built(INPUTS, STATE)[0], fired)
            os._exit(0 if same else 3)
        assert os.waitpid(child, 0)[1] == 0
        assert torch.equal(built(INPUTS, STATE)[0], fired)
    """)
