"""Izhikevich's and the exponential neuron: convergence, published regimes, rheobases, and gradients."""

import dataclasses
import math
from collections.abc import Callable
from itertools import pairwise

import pytest
import torch
from torch import Tensor

from neurorobo.neurons import Surrogate
from neurorobo.neurons.bidimensional import AdEx, Izhikevich
from neurorobo.neurons.bidimensional_config import REGIMES, AdExConfig, IzhikevichConfig
from tests.neurons.stepped import constant, intervals, run

MS = 1_000_000

Derivative = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


def runge_kutta(derivative: Derivative, start: Tensor, ms: float) -> Tensor:
    """Return where ``start`` (2,) is after a time, by the classic method of the fourth order."""

    def change(state: Tensor) -> Tensor:
        return torch.stack(derivative(state[0], state[1]))

    h, state = 0.01, start  # ms
    for _ in range(round(ms / h)):
        first = change(state)
        second = change(state + h / 2 * first)
        third = change(state + h / 2 * second)
        state = state + h / 6 * (first + 2 * second + 2 * third + change(state + h * third))
    return state


def of_izhikevich(cell: Izhikevich, current: float) -> Derivative:
    """Return the published equations below the peak."""
    return lambda v, u: (
        0.04 * v**2 + 5 * v + 140 - u + cell.input_gain * current,
        cell.a * (cell.b * v - u),
    )


def of_adex(cell: AdEx, current: float) -> Derivative:
    """Return the published equations below the peak."""
    return lambda v, w: (
        (
            -cell.leak_nS * (v - cell.rest_mV)
            + cell.leak_nS * cell.slope_mV * ((v - cell.threshold_mV) / cell.slope_mV).exp()
            - w
            + cell.input_gain * current
        )
        / cell.capacitance_pF,
        (cell.a_nS * (v - cell.rest_mV) - w) / cell.time_constant_ms,
    )


@pytest.mark.parametrize(
    ("cell", "derivative", "current"),
    [
        (Izhikevich(), of_izhikevich, 3.5),
        (Izhikevich(a=0.1, b=0.26, d=2.0), of_izhikevich, -2.0),
        (AdEx(), of_adex, 600.0),
        (AdEx(), of_adex, -800.0),
    ],
    ids=["Izhikevich, excited", "Izhikevich, inhibited", "AdEx, excited", "AdEx, inhibited"],
)
def test_the_substeps_converge_to_the_differential_equations_at_first_order(
    cell: Izhikevich | AdEx, derivative: Callable[..., Derivative], current: float
) -> None:
    start = torch.tensor(cell.resting_state, dtype=torch.float64)
    exact = runge_kutta(derivative(cell, current), start, 8.0)
    errors = []
    for substeps in (4, 8, 16, 32):
        stepped = dataclasses.replace(cell, step_ms=1.0, substeps=substeps)
        spikes, states = run(stepped, constant(current, steps=8), start[None])
        assert spikes.sum() == 0
        errors.append((states[-1, 0] - exact).abs())
    for coarse, fine in pairwise(errors):
        assert torch.allclose(coarse / fine, torch.full((2,), 2.0, dtype=torch.float64), rtol=0.15)
    assert errors[-1][0] < 0.1, "mV"


@pytest.mark.parametrize(
    ("cell", "derivative", "current"), [(Izhikevich(), of_izhikevich, 15.0), (AdEx(), of_adex, 1500.0)]
)
def test_the_time_of_the_first_spike_converges_to_that_of_the_differential_equations(
    cell: Izhikevich | AdEx, derivative: Callable[..., Derivative], current: float
) -> None:
    state, exact = torch.tensor(cell.resting_state, dtype=torch.float64), 0.0
    while state[0] < cell.peak_mV:
        state, exact = runge_kutta(derivative(cell, current), state, 0.01), exact + 0.01
    for step_ms in (0.4, 0.2, 0.1, 0.05):
        stepped = dataclasses.replace(cell, step_ms=step_ms, substeps=1)
        spikes, _ = run(stepped, constant(current, steps=round(30 / step_ms)))
        assert abs(float(spikes[:, 0].argmax() + 1) * step_ms - exact) < 4 * step_ms


def fire(regime: str, current: float, *, milliseconds: int = 1000) -> list[int]:
    """Return the intervals, in ms, of a published neuron at rest that hears a constant current from some time on."""
    neuron = IzhikevichConfig.model_validate({"regime": regime, "input_gain": 1.0}).build(MS)
    currents = torch.cat([constant(0.0, steps=200), constant(current, steps=milliseconds)])
    return intervals(run(neuron, currents)[0][:, 0])


def test_regular_spiking_is_tonic_and_adapts() -> None:
    found = fire("regular_spiking", 10.0)
    assert found[0] < 0.6 * found[-1]
    assert len({*found[2:]}) <= 2
    assert len(fire("regular_spiking", 20.0)) > 1.5 * len(found)


def test_intrinsically_bursting_bursts_once_and_goes_on_with_single_spikes() -> None:
    found = fire("intrinsically_bursting", 10.0)
    assert max(found[:2]) < 10
    assert min(found[2:]) > 25


def test_chattering_repeats_bursts_of_close_spikes() -> None:
    found = fire("chattering", 10.0)
    within, between = [each for each in found if each < 10], [each for each in found if each > 30]
    assert len(within) + len(between) == len(found)
    assert len(between) > 10 and len(within) > 2 * len(between)


def test_fast_spiking_fires_fast_without_adaptation() -> None:
    found, regular = fire("fast_spiking", 10.0), fire("regular_spiking", 10.0)
    assert len(found) > 3 * len(regular)
    settled = sum(found[-10:]) / 10
    assert all(abs(each - settled) <= 0.25 * settled for each in found[1:])


def test_low_threshold_spiking_fires_at_currents_that_leave_others_silent_and_adapts() -> None:
    assert not fire("regular_spiking", 2.0)
    found = fire("low_threshold_spiking", 10.0)
    assert len(fire("low_threshold_spiking", 2.0)) > 3
    assert found[0] < 0.5 * found[-1]


def test_thalamo_cortical_is_tonic_from_rest_and_rebounds_from_inhibition() -> None:
    neuron = IzhikevichConfig(regime="thalamo_cortical", input_gain=1.0).build(MS)
    currents = torch.cat([constant(0.0, steps=100), constant(-10.0, steps=200), constant(0.0, steps=100)])
    spikes, _ = run(neuron, currents)
    burst = spikes[:, 0].nonzero()[:, 0]
    assert len(burst) >= 2
    assert 300 <= burst[0] < burst[-1] < 350
    tonic = fire("thalamo_cortical", 3.0)
    assert len(tonic) > 20
    assert max(tonic[-10:]) < 1.5 * min(tonic[-10:])


def test_the_resonator_rings_below_its_threshold_where_others_return_at_once() -> None:
    crossings = {}
    for regime in ("resonator", "regular_spiking"):
        neuron = IzhikevichConfig.model_validate({"regime": regime}).build(MS)
        rest = torch.tensor(neuron.resting_state).double()
        _, states = run(neuron, constant(0.0, steps=100), torch.stack([rest[0] + 1, rest[1]])[None])
        away = states[:, 0, 0] - rest[0]
        crossings[regime] = int((away[away.abs() > 1e-3].sign().diff() != 0).sum())
    assert crossings["resonator"] >= 2
    assert crossings["regular_spiking"] <= 1


@pytest.mark.parametrize("regime", REGIMES)
def test_published_neurons_stay_at_rest_without_a_current(regime: str) -> None:
    neuron = IzhikevichConfig.model_validate({"regime": regime}).build(MS)
    spikes, states = run(neuron, constant(0.0, steps=500))
    assert spikes.sum() == 0
    assert torch.allclose(states, states[:1], atol=1e-3)


@pytest.mark.parametrize("step_us", [500, 2000])
@pytest.mark.parametrize("regime", ["regular_spiking", "intrinsically_bursting", "chattering"])
def test_regimes_are_the_same_at_other_steps(regime: str, step_us: int) -> None:
    """The number of bursts and of single spikes, within a tenth: at the longest step that a file may have, too."""
    neuron = IzhikevichConfig.model_validate({"regime": regime, "input_gain": 1.0}).build(step_us * 1000)
    spikes, _ = run(neuron, constant(10.0, steps=1_000_000 // step_us))
    pauses = [each for each in intervals(spikes[:, 0]) if each * step_us > 15_000]
    expected = [each for each in fire(regime, 10.0) if each > 15]
    assert len(pauses) == pytest.approx(len(expected), rel=0.1)


@pytest.mark.parametrize("substep_us", [500, 250])
def test_inhibition_makes_a_neuron_fire_only_from_where_the_documentation_says(substep_us: int) -> None:
    """About where the map of a substep has a slope under -2, the parabola throws the potential over to its peak."""
    potential = -62.5 - 37.5 / (substep_us / 1000)
    current = -(0.04 * potential**2 + 5 * potential + 140 - 0.2 * potential)
    neuron = IzhikevichConfig(input_gain=1.0, longest_substep=f"{substep_us} us").build(MS)
    spikes, _ = run(neuron, constant(0.1 * current, 0.5 * current, 0.85 * current, 1.1 * current, steps=500))
    assert spikes[:, :3].sum() == 0
    assert spikes[:, 3].sum() > 0


def adex(**values: float) -> AdExConfig:
    """Return a configuration whose inputs are in pA."""
    units = {
        "capacitance": "pF",
        "leak_conductance": "nS",
        "a": "nS",
        "b": "pA",
        "adaptation_time_constant": "ms",
    }
    said = {name: f"{value} {units.get(name, 'mV')}" for name, value in values.items()}
    return AdExConfig.model_validate({"input_gain": "1 pA", **said})


def rest_at_rheobase_mV(cell: AdExConfig) -> float:
    """Return the last potential at which a neuron can rest (Touboul & Brette 2008, Section 2.2).

    With slow adaptation rest ends in a Hopf bifurcation, where the upstroke outweighs the leak by the share
    ``tau_m / tau_w``; with fast one in a saddle-node, where it does so by the share ``a / g_L``.
    """
    tau_m = cell.capacitance / cell.leak_conductance
    share = min(tau_m * MS / cell.adaptation_time_constant, cell.a / cell.leak_conductance)
    return cell.threshold + cell.slope_factor * math.log(1 + share)


def current_pA(cell: AdExConfig, potential: float) -> float:
    """Return the constant current at which a neuron rests at a potential."""
    upstroke = math.exp((potential - cell.threshold) / cell.slope_factor)
    leak = (cell.leak_conductance + cell.a) * (potential - cell.resting_potential)
    return leak - cell.leak_conductance * cell.slope_factor * upstroke


@pytest.mark.parametrize(
    "cell",
    [adex(), adex(a=0.0), adex(a=20.0, adaptation_time_constant=300), adex(a=20.0, adaptation_time_constant=12)],
    ids=["published: Hopf", "no adaptation: saddle-node", "strong: Hopf", "fast: saddle-node"],
)
def test_adex_fires_from_its_rheobase_on(cell: AdExConfig) -> None:
    """From the rest of a current that is two percent below it: a kick dies out there; two percent above, it fires."""
    rheobase = current_pA(cell, rest_at_rheobase_mV(cell))
    low, high = cell.resting_potential, rest_at_rheobase_mV(cell)
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if current_pA(cell, middle) < 0.98 * rheobase else (low, middle)
    rest = torch.tensor([low, cell.a * (low - cell.resting_potential)]).double()
    currents = constant(0.98 * rheobase, 1.02 * rheobase, steps=1500)
    spikes, states = run(cell.build(MS), currents, (rest + torch.tensor([0.05, 0.0])).repeat(2, 1))
    assert spikes[:, 0].sum() == 0
    assert states[-1, 0].tolist() == pytest.approx(rest.tolist(), abs=0.01)
    assert spikes[:, 1].sum() > 0


NAUD = {"threshold": -50.0, "slope_factor": 2.0}


def adex_intervals(current_pA: float, **values: float) -> list[float]:
    """Return the intervals, in ms, in 600 ms of a constant current."""
    config = adex(**NAUD, **values)
    config.check(MS // 5)
    return [each * 0.2 for each in intervals(run(config.build(MS // 5), constant(current_pA, steps=3000))[0][:, 0])]


def test_adex_has_the_patterns_of_naud_et_al() -> None:
    """Tonic, adapting, an initial and regular bursts; the values are those of Brian's example of that paper."""
    cell = {"capacitance": 200.0, "leak_conductance": 10.0, "resting_potential": -70.0, "reset_potential": -58.0}
    tonic = adex_intervals(500, **cell, a=2.0, adaptation_time_constant=30, b=0.0)
    assert max(tonic[3:]) < 1.06 * min(tonic[3:])

    cell["leak_conductance"] = 12.0
    adapting = adex_intervals(500, **cell, a=2.0, adaptation_time_constant=300, b=60.0)
    assert adapting[0] < 0.25 * adapting[-1]
    assert all(late >= 0.99 * early for early, late in pairwise(adapting))

    cell = {"capacitance": 130.0, "leak_conductance": 18.0, "resting_potential": -58.0, "reset_potential": -50.0}
    initial = adex_intervals(400, **cell, a=4.0, adaptation_time_constant=150, b=120.0)
    assert max(initial[:2]) < 0.2 * min(initial[2:])

    cell = {"capacitance": 200.0, "leak_conductance": 10.0, "resting_potential": -58.0, "reset_potential": -46.0}
    bursts = adex_intervals(210, **cell, a=2.0, adaptation_time_constant=120, b=100.0)
    pauses = [number for number, each in enumerate(bursts) if each > 50]
    assert len(pauses) >= 3
    assert max(each for each in bursts if each < 50) < 0.1 * min(bursts[number] for number in pauses)


def test_below_the_threshold_adaptation_relaxes_to_a_times_the_potential() -> None:
    config = adex(a=10.0, adaptation_time_constant=20)
    _, states = run(config.build(MS), constant(-200.0, steps=400))
    potential, adaptation = states[-1, 0]
    assert float(potential) == pytest.approx(-70.6 - 200 / (30 + 10), abs=0.01)
    assert float(adaptation) == pytest.approx(10 * (float(potential) + 70.6), rel=1e-6)


@pytest.mark.parametrize("cell", [Izhikevich(substeps=3), AdEx(substeps=8, input_gain=500.0)])
def test_gradients_of_silent_neurons_are_those_of_finite_differences(cell: Izhikevich | AdEx) -> None:
    narrow = dataclasses.replace(cell, surrogate=Surrogate("rectangular", 1e-3))
    generator = torch.Generator().manual_seed(0)
    current = torch.randn(4, 3, generator=generator).double().requires_grad_()
    potential = -70 + 15 * torch.rand(4, 3, generator=generator).double()
    state = torch.cat([potential, 5 * torch.randn(4, 3, generator=generator).double()], dim=1).requires_grad_()
    assert narrow.step(current, state)[0].sum() == 0
    assert torch.autograd.gradcheck(narrow.step, (current, state))


def test_a_spike_hands_its_gradient_to_the_last_substep_of_its_upstroke() -> None:
    """``dS/dI = D(0) h`` and ``dS/dV = D(0) (1 + h (0.08 V + 5))``; behind the reset, ``dV' = (c - peak) dS``."""
    cell = Izhikevich(substeps=1, step_ms=0.5, surrogate=Surrogate("arctan", 20.0))
    current = torch.tensor([[100.0]], dtype=torch.float64, requires_grad=True)
    state = torch.tensor([[20.0, -13.0]], dtype=torch.float64, requires_grad=True)
    at_peak = float(cell.surrogate.derivative(torch.zeros(1, dtype=torch.float64)))
    spikes, after = cell.step(current, state)
    assert spikes.item() == 1
    assert after[0].tolist()[0] == -65.0
    to_current, to_state = torch.autograd.grad(spikes.sum(), (current, state), retain_graph=True)
    assert to_current.item() == pytest.approx(at_peak * 0.5)
    assert to_state[0].tolist() == pytest.approx([at_peak * (1 + 0.5 * (0.08 * 20 + 5)), -at_peak * 0.5])
    (behind,) = torch.autograd.grad(after[0, 0], current)
    assert behind.item() == pytest.approx((-65 - 30) * at_peak * 0.5)


def test_a_neuron_that_reached_its_peak_early_waits_there_and_fires_once() -> None:
    cell = Izhikevich(step_ms=2.0, substeps=20)
    spikes, states = run(cell, constant(400.0, steps=10))
    assert set(spikes[:, 0].tolist()) == {1.0}, "it would fire more often than once a step"
    assert (states[:, 0, 0] == -65).all()
