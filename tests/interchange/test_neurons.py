"""A node of NIR, solved by Euler's method as NIR has it, fires as our neuron does, and becomes that neuron again."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from neurorobo.errors import NeuroroboError
from neurorobo.interchange.library import nir
from neurorobo.interchange.neurons import STEP_S, TIE, Membrane, from_node, to_node
from neurorobo.neurons import LIF
from neurorobo.neurons.lif import just_above

Floats = NDArray[np.float64]


def euler(node: object, currents: Floats) -> Floats:
    """Solve a LIF or IF node for currents (steps, neurons), as its documentation has it."""
    values = {key: np.asarray(value, np.float64) for key, value in vars(node).items() if key in ("r", "v_threshold")}
    leaks = hasattr(node, "tau")
    tau = np.asarray(node.tau, np.float64) if leaks else np.full_like(values["r"], np.inf)  # type: ignore[attr-defined]
    rest = np.asarray(getattr(node, "v_leak", 0.0), np.float64)
    reset = np.asarray(node.v_reset, np.float64)  # type: ignore[attr-defined]
    potential, spikes = np.broadcast_to(rest, values["r"].shape).copy(), []
    for current in currents:
        if leaks:
            potential = potential + STEP_S / tau * (rest - potential + values["r"] * current)
        else:
            potential = potential + STEP_S * values["r"] * current
        fired = potential > values["v_threshold"]
        potential = np.where(fired, reset, potential)
        spikes.append(fired)
    return np.array(spikes, np.float64)


def in_single_precision(node: object, currents: Floats) -> Floats:
    """Solve a node that rests at zero, of resistance one if it leaks, as libraries do."""
    values = {key: torch.tensor(value) for key, value in vars(node).items() if key in ("tau", "r", "v_threshold")}
    potential, trains = torch.zeros(currents.shape[1]), []
    for current in torch.tensor(currents, dtype=torch.float32):
        leaks = "tau" in values
        change = STEP_S / values["tau"] * (current - potential) if leaks else STEP_S * values["r"] * current
        potential = potential + change
        fired = (potential > values["v_threshold"]).float()
        potential = potential * (1 - fired)
        trains.append(fired.numpy())
    return np.array(trains, np.float64)


def ours(decay: float, thresholds: Floats, currents: Floats, *, at: bool = True) -> tuple[Floats, Floats]:
    """Return the spikes of our neurons and how far their potentials were from the threshold."""
    potential, fired = np.zeros(currents.shape[1]), np.zeros(currents.shape[1])
    spikes, distances = [], []
    for current in currents:
        potential = decay * potential * (1 - fired) + current
        distances.append(potential - thresholds)
        fired = (distances[-1] >= 0 if at else distances[-1] > 0).astype(np.float64)
        spikes.append(fired)
    return np.array(spikes), np.array(distances)


def test_ours_here_is_that_of_the_framework() -> None:
    currents = np.random.default_rng(0).normal(0, 0.5, (50, 30))
    potential, framework = torch.zeros(30, dtype=torch.float64), []
    for current in torch.tensor(currents):
        fired, potential = LIF(0.5, 0.2).step(current, potential)
        framework.append(fired.numpy())
    assert np.array_equal(ours(0.2, np.full(30, 0.5), currents)[0], np.array(framework))


@given(
    decay=st.floats(0, 1),
    threshold=st.floats(0.01, 10),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_node_fires_as_the_neuron_that_it_is_written_for(decay: float, threshold: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    thresholds = threshold * rng.uniform(0.5, 2, 8)
    decay = decay if decay == 1 else min(decay, 0.999)  # beyond, single precision tells decays apart no more
    currents = threshold * rng.normal(0.2, 0.5, (40, 8))
    spikes, distances = ours(decay, thresholds, currents)
    theirs = euler(to_node(Membrane(decay, thresholds)), currents)
    for neuron in range(8):
        different = (spikes[:, neuron] != theirs[:, neuron]).nonzero()[0]
        if len(different):
            assert abs(distances[different[0], neuron]) < 2e-4 * threshold


def test_where_a_potential_equals_the_threshold_both_fire() -> None:
    """Weights on a grid meet the threshold often; Euler's method in single precision rounds on the way there."""
    rng = np.random.default_rng(1)
    currents = rng.integers(-8, 9, (400, 50)) / 16
    spikes, distances = ours(0.25, np.full(50, 0.5), currents)
    assert (distances == 0).sum() > 50
    node = to_node(Membrane(0.25, np.full(50, 0.5)))
    assert np.array_equal(euler(node, currents), spikes)
    assert not np.array_equal(ours(0.25, np.full(50, 0.5), currents, at=False)[0], spikes)
    assert np.array_equal(in_single_precision(node, currents), spikes)


@pytest.mark.parametrize("decay", [0.0, 0.2, 0.9, 0.99, 1.0])
@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_numbers_come_back_as_they_were_meant(decay: float, precision: type) -> None:
    node = to_node(Membrane(decay, np.array([0.5, 0.7])))
    for key in ("tau", "r", "v_leak", "v_threshold", "v_reset"):
        if hasattr(node, key):
            setattr(node, key, getattr(node, key).astype(precision))
    read = from_node("hidden", node, STEP_S)
    assert read.decay == pytest.approx(decay, abs=1e-6)
    assert read.thresholds == pytest.approx(np.array([0.5, 0.7]) * (1 - TIE), rel=2e-7)
    if precision is np.float32:
        assert read.decay == decay


def test_a_tie_that_does_not_fire_here_does_not_fire_in_the_node() -> None:
    """Of neurons that fire above their threshold, as those of any file that is not ours."""
    currents = np.random.default_rng(1).integers(-8, 9, (400, 50)) / 16
    for decay in (0.0, 0.2, 0.25, 0.5, 0.75, 0.9, 1.0):
        spikes, distances = ours(decay, np.full(50, 0.5), currents, at=False)
        assert (distances == 0).sum() > 50
        node = to_node(Membrane(decay, np.full(50, 0.5), ties_fire=False))
        assert np.array_equal(in_single_precision(node, currents), spikes)
    assert (to_node(Membrane(1.0, np.array([0.5, 0.7]), ties_fire=False)).v_threshold == np.float32([0.5, 0.7])).all()


def fires(read: Membrane, potentials: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which neurons fire in their first step, in single precision, as layers have it."""
    above = [LIF(just_above(threshold), read.decay) for threshold in read.thresholds]
    steps = [neuron.step(torch.tensor(u), torch.tensor(0.0))[0] for neuron, u in zip(above, potentials, strict=True)]
    return np.array([bool(step) for step in steps])


def test_an_input_that_equals_an_imported_threshold_does_not_fire_and_the_next_number_does() -> None:
    thresholds = np.random.default_rng(0).uniform(0.01, 3, 300).astype(np.float32)
    node = nir().IF(r=np.full(300, 1 / STEP_S, np.float32), v_threshold=thresholds, v_reset=np.zeros(300, np.float32))
    read = from_node("lif", node, STEP_S)
    assert not fires(read, thresholds).any()
    assert fires(read, np.nextafter(thresholds, np.float32(np.inf))).all()


def test_an_imported_leaky_neuron_is_that_of_the_node_to_single_precision() -> None:
    """Its decay gives the very time constant; its threshold is the nearest number, so nothing fires at or below it."""
    rng = np.random.default_rng(0)
    thresholds = rng.uniform(0.01, 3, 300).astype(np.float32)
    taus = (STEP_S * rng.uniform(1.1, 300, 300)).astype(np.float32)
    for tau, threshold in zip(taus, thresholds, strict=True):
        one = {"r": np.float32([0.7]), "v_leak": np.float32([0]), "v_reset": np.float32([0])}
        read = from_node("lif", nir().LIF(tau=tau[None], v_threshold=threshold[None], **one), STEP_S)
        assert np.float32(STEP_S / (1 - read.decay)) == tau
        exact = float(threshold) / ((1 - read.decay) * float(np.float32(0.7)))
        nearest = np.float32(exact)
        assert np.float32(read.thresholds[0]) == nearest
        below = nearest if nearest <= exact else np.nextafter(nearest, np.float32(0))
        assert not fires(read, np.array([below])).any()
        assert fires(read, np.array([np.nextafter(nearest, np.float32(np.inf))])).all()


@given(
    rest=st.floats(-2, 2),
    r=st.floats(0.1, 10),
    above=st.floats(0.1, 3),
    tau=st.floats(1.1 * STEP_S, 100 * STEP_S),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_resistance_and_any_rest_that_is_the_reset_too_is_our_neuron(
    rest: float, r: float, above: float, tau: float, seed: int
) -> None:
    def of(value: float) -> Floats:
        return np.full(6, value)

    node = nir().LIF(tau=of(tau), r=of(r), v_leak=of(rest), v_threshold=of(rest + above), v_reset=of(rest))
    read = from_node("lif", node, STEP_S)
    currents = np.random.default_rng(seed).normal(0.3, 1, (40, 6)) * above / r
    spikes, distances = ours(read.decay, read.thresholds, currents, at=False)
    different = (spikes != euler(node, currents)).nonzero()
    if len(different[0]):
        assert abs(distances[different[0][0], different[1][0]]) < 1e-6 * read.thresholds[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"v_reset": [0.1, 0.1]}, "reset to another potential than it rests at"),
        ({"tau": [2e-4, 3e-4]}, "several time constants"),
        ({"tau": [5e-5, 5e-5]}, "too short for steps of 0.0001 s"),
        ({"tau": [0.0, 0.0]}, "time constant that is not positive"),
        ({"tau": [math.nan, 2e-4]}, "`tau` holds a value that is not a number"),
        ({"r": [-1.0, 1.0]}, "fires at rest or never"),
        ({"v_threshold": [0.0, 1.0]}, "fires at rest or never"),
    ],
)
def test_a_node_that_is_no_neuron_of_ours_is_refused_by_name(changes: dict[str, list[float]], words: str) -> None:
    values = {"tau": [2e-4] * 2, "r": [1.0] * 2, "v_leak": [0.0] * 2, "v_threshold": [0.5] * 2, "v_reset": [0.0] * 2}
    node = nir().LIF(**{key: np.array(value) for key, value in {**values, **changes}.items()})
    with pytest.raises(NeuroroboError, match=words) as refused:
        from_node("hidden.lif", node, STEP_S)
    assert str(refused.value).startswith("the node `hidden.lif` (LIF) cannot be imported: ")
