"""What makes no sense is refused by name and numbers before a kernel runs, on both paths; what is empty is served.

Spikes and weights that are none, and sizes that do not fit, are in `test_paths.py`, weights of other shapes in
`test_torch.py`, and too many synapses in `tests/synapses/test_projection.py`.
"""

from typing import Any

import pytest
import torch
from torch import Tensor

from neurorobo.engine import run_steps, run_window
from neurorobo.neurons import LIF
from tests.engine.test_paths import INPUTS, layer

NAN, INFINITY = float("nan"), float("inf")
CURRENT, STATE = torch.ones(5, 3, 20), torch.zeros(3, 20)


def with_one(tensor: Tensor, value: float) -> Tensor:
    broken = tensor.clone()
    broken.view(-1)[7] = value
    return broken


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"current": CURRENT[0]}, r"\(steps, batch, neurons\) and at least one step, got a current of \(3, 20\)"),
        ({"current": CURRENT[:0]}, r"at least one step, got a current of \(0, 3, 20\)"),
        ({"current": CURRENT.long()}, r"a current is of floating-point numbers, got torch.int64"),
        ({"current": with_one(CURRENT, NAN)}, r"a current is a finite number, got nan at \[0, 0, 7\]"),
        ({"current": with_one(CURRENT, -INFINITY)}, r"a current is a finite number, got -inf at \[0, 0, 7\]"),
        ({"potential": STATE[:1]}, r"potential is of \(1, 20\) \(batch, neurons\), the current of \(3, 20\)"),
        ({"potential": STATE.double()}, r"a potential of torch.float64 does not go with a current of torch.float32"),
        ({"potential": with_one(STATE, NAN)}, r"a potential is a finite number, got nan at \[0, 7\]"),
        ({"potential": with_one(STATE, INFINITY)}, r"a potential is a finite number, got inf at \[0, 7\]"),
        ({"threshold": torch.ones(19)}, r"one for all or for each of 20, got \(19,\)"),
        ({"threshold": torch.ones(3, 20)}, r"one for all or for each of 20, got \(3, 20\)"),
        ({"threshold": with_one(torch.ones(20), NAN)}, r"a threshold is a finite number, got nan at \[7\]"),
        ({"threshold": torch.tensor(INFINITY)}, r"a threshold is a finite number, got inf at \[\]"),
        ({"recurrent_weight": torch.ones(20, 19)}, r"of 20 neurons are of \(20, 20\), got \(20, 19\)"),
        ({"recurrent_weight": torch.ones(20, 20).half()}, r"a recurrent weight of torch.float16 does not go with"),
        ({"recurrent_weight": with_one(torch.ones(20, 20), NAN)}, r"a recurrent weight is .* got nan at \[0, 7\]"),
    ],
)
def test_a_window_that_makes_no_sense_is_refused(path: str, changed: dict[str, Tensor], words: str) -> None:
    arguments: dict[str, Any] = {"current": CURRENT.clone(), "potential": STATE, **changed}
    with pytest.raises(ValueError, match=words):
        run_window(neuron=LIF(), **arguments)
    if "current" not in changed:
        assert torch.equal(arguments["current"], CURRENT)  # which a kernel would have overwritten


@pytest.mark.parametrize("current", [CURRENT[0], CURRENT[:0]])
def test_steps_that_make_no_sense_are_refused(current: Tensor) -> None:
    with pytest.raises(ValueError, match=r"\(steps, batch, neurons\) and at least one step, got a current of"):
        run_steps(current, STATE, LIF())


@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize("dtype", [torch.bool, torch.int64, torch.float64, torch.bfloat16])
def test_spikes_of_another_type_of_numbers_are_refused(path: str, dtype: torch.dtype, training: bool) -> None:
    with (
        torch.set_grad_enabled(training),
        pytest.raises(ValueError, match=f"projection 1 of torch.float32 was given spikes of {dtype}"),
    ):
        layer()([INPUTS[0], INPUTS[1].to(dtype)], STATE)


@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize("dtype", [torch.int64, torch.float64])
def test_a_state_of_another_type_of_numbers_is_refused(path: str, dtype: torch.dtype, training: bool) -> None:
    with torch.set_grad_enabled(training), pytest.raises(ValueError, match=f"a potential of {dtype} does not go with"):
        layer()(INPUTS, STATE.to(dtype))


@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize("value", [NAN, INFINITY, -INFINITY])
def test_a_state_that_is_not_finite_is_refused(path: str, value: float, training: bool) -> None:
    built = layer()
    with torch.set_grad_enabled(training):
        built(INPUTS, STATE)
        with pytest.raises(ValueError, match=rf"a potential is a finite number, got {value} at \[0, 7\]"):
            built(INPUTS, with_one(STATE, value))
        assert torch.equal(built(INPUTS, STATE)[0], layer()(INPUTS, STATE)[0])


@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize("value", [-1, 12, 2**40])
def test_an_index_of_a_source_that_there_is_not_is_refused(path: str, value: int, training: bool) -> None:
    """However it came there: by a file, or in place after a window was run."""
    built, words = layer(), rf"projection 1: source_index lies in 0\.\.11, got {value} at \[3, 2\]"
    weights = {name: tensor.clone() for name, tensor in built.state_dict().items()}
    weights["projections.1.source_index"][3, 2] = value
    with torch.set_grad_enabled(training):
        with pytest.raises(ValueError, match=words):
            torch.func.functional_call(layer(), weights, (INPUTS, STATE))
        built(INPUTS, STATE)
        built.load_state_dict(weights)
        with pytest.raises(ValueError, match=words):
            built(INPUTS, STATE)


def test_an_index_of_another_kind_is_refused(path: str) -> None:
    built = layer()
    index = built.projections[1].source_index
    for broken in (index.int(), index[:19], index[:, :0]):
        built.projections[1].source_index = broken
        with pytest.raises(ValueError, match=r"projection 1: source_index is of torch.int64|\(20, 0\), got \(20, 3\)"):
            built(INPUTS, STATE)


def test_an_empty_batch_is_served(path: str) -> None:
    """As torch's own modules do it: with results, and gradients, of the right shape."""
    built = layer()
    inputs, state = [x[:, :0].clone().requires_grad_() for x in INPUTS], STATE[:0].clone().requires_grad_()
    with torch.no_grad():
        for _ in range(2):
            fired, last = built(inputs, state)
            assert fired.shape == (10, 0, 20)
            assert last.shape == (0, 20)
    fired, last = built(inputs, state)
    (fired.sum() + last.sum()).backward()
    assert state.grad is not None and state.grad.shape == (0, 20)
    assert [x.grad.shape for x in inputs if x.grad is not None] == [(10, 0, 30), (10, 0, 12)]
    for parameter in built.parameters():
        assert parameter.grad is not None and parameter.grad.shape == parameter.shape and not parameter.grad.any()
