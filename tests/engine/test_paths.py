"""Which path the engine takes and why; both refuse the same, and neither is harmed by torch's transforms."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor

from neurorobo.engine import Layer, engine_path, native
from neurorobo.errors import NeuroroboError
from neurorobo.neurons import LIF, Surrogate
from neurorobo.regions.weights import to_grid
from neurorobo.synapses import Dense, FanIn
from tests.engine.paths import engine, needs_native


@pytest.fixture
def no_libraries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An installation whose compiler failed."""
    monkeypatch.setattr(native, "FOLDER", tmp_path)
    monkeypatch.delenv(native.LIBRARIES_VARIABLE, raising=False)
    native._load.cache_clear()
    yield tmp_path
    native._load.cache_clear()


LIBRARIES = Path(os.environ.get(native.LIBRARIES_VARIABLE, native.FOLDER))


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def spikes(steps: int, batch: int, neurons: int) -> Tensor:
    return (torch.rand(steps, batch, neurons, generator=generator(1)) < 0.3).float()


def layer() -> Layer:
    projections = [Dense(30, 20, generator(), gain=1.5), FanIn(12, 20, 3, generator(1))]
    built = Layer(
        projections, LIF(surrogate=Surrogate("arctan")), Dense(20, 20, generator(2)), trainable_threshold=True
    )
    with torch.no_grad():
        for parameter in built.parameters():
            parameter.copy_(to_grid(parameter))
    return built


INPUTS = [spikes(10, 3, 30), spikes(10, 3, 12)]


def test_without_libraries_the_engine_takes_the_portable_path_and_says_why(no_libraries: Path) -> None:
    with engine(""):
        assert engine_path().name == "portable"
        assert "no C compiler" in engine_path().reason
    with engine("native"), pytest.raises(NeuroroboError, match=r"native path was asked for, but .* no C compiler"):
        engine_path()


@needs_native()
def test_a_library_of_another_version_is_not_used(no_libraries: Path) -> None:
    for file in LIBRARIES.glob("_native_*"):
        shutil.copy(file, no_libraries)
    with engine(""):
        assert engine_path().name == "native"  # no source to compare with, as in an installation
    native._load.cache_clear()
    for name in native.SOURCES:
        shutil.copy(Path(native.__file__).with_name(name), no_libraries)
    with (no_libraries / native.SOURCES[-1]).open("a") as source:
        source.write("/* changed */\n")
    with engine(""):
        assert engine_path().name == "portable"
        assert "was built from another version of native.c and models.h" in engine_path().reason


@needs_native()
def test_a_library_that_cannot_be_loaded_is_not_used(no_libraries: Path) -> None:
    for file in LIBRARIES.glob("_native_*"):
        (no_libraries / file.name).write_bytes(b"no library")
    with engine(""):
        assert engine_path().name == "portable"
        assert "cannot be loaded" in engine_path().reason


@needs_native()
def test_libraries_from_another_folder_are_named(no_libraries: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(native.LIBRARIES_VARIABLE, str(LIBRARIES))
    with engine("native"):
        assert engine_path().reason.endswith(f"in NEUROROBO_LIBRARIES={LIBRARIES}")
    native._load.cache_clear()
    monkeypatch.setenv(native.LIBRARIES_VARIABLE, str(no_libraries))
    with engine("native"), pytest.raises(NeuroroboError, match=r"no library for baseline in NEUROROBO_LIBRARIES=/"):
        engine_path()


@pytest.mark.parametrize(
    ("engine_name", "instructions", "words"),
    [
        ("fast", "", "`native`, `portable` or unset, not 'fast'"),
        ("", "mmx", "baseline, avx2, avx512 or unset, not 'mmx'"),
    ],
)
def test_an_unknown_path_is_refused(engine_name: str, instructions: str, words: str) -> None:
    with engine(engine_name, instructions), pytest.raises(NeuroroboError, match=words):
        engine_path()


@needs_native()
def test_an_instruction_set_that_the_processor_lacks_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "_processor", lambda: (0, None))
    with engine("", "avx512"), pytest.raises(NeuroroboError, match="this processor has no avx512"):
        engine_path()
    with engine(""):
        assert engine_path().instructions == "baseline"


@needs_native()
def test_both_paths_give_the_same_spikes_and_gradients() -> None:
    found = []
    for name in ("native", "portable"):
        with engine(name):
            built = layer()
            fired, state = built(INPUTS, built.at_rest(3))
            (fired * torch.randn(fired.shape, generator=generator(3))).sum().backward()
            found.append((fired, state, [parameter.grad for parameter in built.parameters()]))
    (fired, state, gradients), (their_fired, their_state, their_gradients) = found
    assert torch.equal(fired, their_fired)
    assert torch.equal(state, their_state)
    assert 0.05 < fired.mean() < 0.95
    for gradient, theirs in zip(gradients, their_gradients, strict=True):
        assert (gradient - theirs).abs().max() <= 1e-5 * theirs.abs().max()


@pytest.mark.parametrize("value", [0.5, 2.0, -1.0, 2.0**-149, 1e-30, float("nan"), float("inf")])
def test_what_is_no_spike_is_refused_with_its_place(path: str, value: float) -> None:
    broken = INPUTS[1].clone()
    broken[7, 2, 11] = value
    with pytest.raises(ValueError, match=rf"0 or 1, got {value:g} from source 11 \(step 7, batch element 2\)"):
        layer()([INPUTS[0], broken], torch.zeros(3, 20))


@pytest.mark.parametrize("value", [float("nan"), float("-inf")])
@pytest.mark.parametrize(
    ("name", "place", "words"),
    [
        ("projections.0.weight", (3, 29), r"projection 0: weights are finite numbers, got {} at \[3, 29\]"),
        ("projections.1.weight", (19, 2), r"projection 1: weights are finite numbers, got {} at \[19, 2\]"),
        ("recurrent.weight", (0, 5), r"recurrent: weights are finite numbers, got {} at \[0, 5\]"),
        ("threshold", (4,), r"threshold: weights are finite numbers, got {} at \[4\]"),
    ],
)
def test_a_weight_that_is_no_number_is_refused_with_its_place(
    path: str, value: float, name: str, place: tuple[int, ...], words: str
) -> None:
    built = layer()
    built(INPUTS, torch.zeros(3, 20))  # what was fine once is looked at again
    with torch.no_grad():
        built.get_parameter(name)[place] = value
    with pytest.raises(ValueError, match=words.format(value)):
        built(INPUTS, torch.zeros(3, 20))


def test_finite_numbers_are_taken_though_their_sum_is_not(path: str) -> None:
    built, largest = layer(), torch.finfo(torch.float32).max
    with torch.no_grad():
        for parameter in built.parameters():
            parameter.fill_(largest)
    fired, state = built([torch.zeros_like(x) for x in INPUTS], torch.full((3, 20), largest / 2))
    assert not fired.any()
    assert state.isfinite().all()


@pytest.mark.parametrize(
    ("inputs", "state", "words"),
    [
        ([INPUTS[0][:0], INPUTS[1][:0]], torch.zeros(3, 20), r"at least one step, got \(0, 3, 30\)"),
        ([INPUTS[0][0], INPUTS[1][0]], torch.zeros(3, 20), r"\(steps, batch, sources\) .* got \(3, 30\)"),
        ([INPUTS[0], INPUTS[1][..., 1:]], torch.zeros(3, 20), "of 12 sources was given the spikes of 11"),
        ([INPUTS[0], INPUTS[1][:, 1:]], torch.zeros(3, 20), r"agree in steps and batch, got \[\(10, 2\), \(10, 3\)\]"),
        ([INPUTS[0]], torch.zeros(3, 20), "a layer of 2 projections was given 1 inputs"),
        (INPUTS, torch.zeros(1, 20), r"\(1, 20\) \(batch, neurons\), the current of \(3, 20\)"),
        (INPUTS, torch.zeros(3, 19), r"\(3, 19\) \(batch, neurons\), the current of \(3, 20\)"),
    ],
)
def test_sizes_that_do_not_fit_are_refused_with_their_numbers(
    path: str, inputs: list[Tensor], state: Tensor, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        layer()(inputs, state)


def test_double_precision_runs_on_either_path(path: str) -> None:
    built = layer()
    expected, _ = built(INPUTS, torch.zeros(3, 20))
    found, _ = built.double()([x.double() for x in INPUTS], torch.zeros(3, 20, dtype=torch.float64))
    assert found.dtype is torch.float64
    assert torch.equal(found.float(), expected)


def test_the_transforms_of_torch_func_are_refused_by_name(path: str) -> None:
    built, state = layer(), torch.zeros(3, 20)
    with pytest.raises(NotImplementedError, match=r"not under vmap, grad or others of torch\.func"):
        torch.func.vmap(lambda x: built([x, INPUTS[1]], state)[0])(INPUTS[0].unsqueeze(0))

    def loss(weight: Tensor) -> Tensor:
        return torch.func.functional_call(built, {"recurrent.weight": weight}, (INPUTS, state))[0].sum()

    with pytest.raises(NotImplementedError, match=r"not under vmap, grad or others of torch\.func"):
        torch.func.grad(loss)(torch.zeros(20, 20))
    assert loss(torch.zeros(20, 20)) != built(INPUTS, state)[0].sum()  # other weights in its place are no transform


def test_second_derivatives_are_refused_by_name(path: str) -> None:
    built = layer()
    fired, _ = built(INPUTS, torch.zeros(3, 20))
    with pytest.raises(NotImplementedError, match=r"cannot be differentiated again \(create_graph=True\)"):
        torch.autograd.grad(fired.sum(), list(built.parameters()), create_graph=True)


def test_a_compiled_model_runs_its_layers_as_they_are(path: str) -> None:
    """In a process of its own, as torch.compile warns of deprecations that are not ours."""
    program = """
import torch
from tests.engine.test_paths import INPUTS, layer
built, state = layer(), torch.zeros(3, 20)
def model(x):
    return built([x * 1.0, INPUTS[1]], state)[0].mean(0) * 2
compiled = torch.compile(model, backend="eager")
for run in (model, compiled):
    built.zero_grad()
    found = run(INPUTS[0])
    found.sum().backward()
    run.found, run.gradients = found, [p.grad.clone() for p in built.parameters()]
assert torch.equal(model.found, compiled.found)
assert all(torch.equal(a, b) for a, b in zip(model.gradients, compiled.gradients, strict=True))
"""
    project = str(Path(__file__).parents[2])
    subprocess.run([sys.executable, "-c", program], check=True, cwd=project, timeout=120)


def test_inference_mode_is_served_and_leaves_nothing_behind(path: str) -> None:
    built, state = layer(), torch.zeros(3, 20)
    expected, _ = built(INPUTS, state)
    with torch.inference_mode():
        assert torch.equal(built(INPUTS, state)[0], expected)
        inside = layer()  # weights whose changes torch does not count
        inside(INPUTS, state)
        for parameter in inside.parameters():
            parameter.mul_(-1)
        assert not torch.equal(inside(INPUTS, state)[0], expected)
    built(INPUTS, state)[0].sum().backward()
