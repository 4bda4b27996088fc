"""The spiking cerebellum: its codes, its constraints, its data, and that it can learn from its teacher."""

import subprocess
import sys
from typing import Any

import pytest
import torch
from precision_interaction.data.compensation_states import CompensationStates, CompensationStatesConfig
from precision_interaction.regions.cerebellum import Cerebellum
from precision_interaction.regions.cerebellum_config import CerebellumConfig
from precision_interaction.teachers.compensators import PredictiveCompensator, ProfileCompensator
from precision_interaction.teachers.compensators_config import PredictiveConfig, ProfileConfig
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.errors import ConfigError
from neurorobo.learning.evaluate import evaluate
from neurorobo.learning.phase import SupervisePhase
from neurorobo.learning.supervise import supervise
from neurorobo.regions.weights_file import signature_hash

SMALL = {"granule_cells": 80, "purkinje_cells": 40}
PERIODS_MS = (1000, 200, 50)


def clock(period_ms: int = 1000, name: str = "radial") -> Clock:
    return Clock({"control": 10**9, name: period_ms * 10**6}, 10**6, 50)


def cerebellum(**options: Any) -> Cerebellum:
    config = CerebellumConfig.model_validate({**SMALL, **options})
    return Cerebellum(config, clock(), torch.Generator().manual_seed(1))


def states(batch: int, period_ms: int = 1000, seed: int = 1) -> dict[str, Tensor]:
    data = CompensationStates(CompensationStatesConfig(), clock(period_ms))
    return data.draw(batch, torch.Generator().manual_seed(seed))


def spikes(region: Cerebellum, values: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: port.code.encode(values[name], 50) for name, port in region.input_ports.items() if port.code}


@pytest.mark.parametrize("module", ["regions.cerebellum_config", "data.compensation_states"])
def test_configurations_do_not_import_torch(module: str) -> None:
    check = f"import sys, precision_interaction.{module}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


@pytest.mark.parametrize("period_ms", PERIODS_MS)
def test_the_velocity_is_the_move_per_period(period_ms: int) -> None:
    outputs = CerebellumConfig().outputs(clock(period_ms))
    move, velocity = outputs["move"], outputs["velocity"]
    assert (move.unit, velocity.unit) == ("um", "um/s")
    counts = torch.randint(0, 2, (50, 3, move.channels)).float()
    assert move.code is not None and velocity.code is not None
    torch.testing.assert_close(velocity.code.decode(counts), move.code.decode(counts) / (period_ms / 1000))


@pytest.mark.parametrize("period_ms", PERIODS_MS)
def test_default_ranges_hold_what_occurs_and_no_more(period_ms: int) -> None:
    config = CerebellumConfig()
    values = states(4000, period_ms)
    teacher = PredictiveCompensator(PredictiveConfig(), clock(period_ms), torch.Generator())
    wanted, _ = teacher.step(values, {})
    for name, port in config.inputs(clock(period_ms)).items():
        assert port.code is not None
        assert port.code.saturated(values[name]).float().mean() < 0.05
    for name in ("move", "residual"):
        code = config.outputs(clock(period_ms))[name].code
        assert code is not None
        assert code.saturated(wanted[name]).float().mean() < 0.15
        assert wanted[name].max() - wanted[name].min() > 0.7 * (code.hi - code.lo)


@pytest.mark.parametrize("period_ms", PERIODS_MS)
def test_a_move_can_take_off_force_beside_the_fastest_contact(period_ms: int) -> None:
    move = CerebellumConfig().ranges(clock(period_ms))["move"]
    fastest_um = 1.072 * 100 * period_ms / 1000 / 80
    assert 80 * (move.hi - fastest_um) > 10
    assert 80 * move.lo < -10


def test_the_signature_knows_ranges_and_period_but_not_its_name() -> None:
    config = CerebellumConfig()
    default = config.signature(clock())
    assert config.signature(clock(200)) != default
    assert CerebellumConfig.model_validate({"force": "-50..50 mN"}).signature(clock()) != default
    assert CerebellumConfig(nuclei=16).signature(clock()) != default
    assert CerebellumConfig(period="slow").signature(clock(name="slow")) == default
    assert CerebellumConfig(weights="pretrained").signature(clock()) == default
    spelt_out = {
        name: f"{r.lo!r}..{r.hi!r} {unit}"
        for (name, r), unit in zip(
            config.ranges(clock()).items(), ("mN", "um/s", "mN", "mN^2", "um", "mN"), strict=True
        )
    }
    assert CerebellumConfig.model_validate(spelt_out).signature(clock()) == default


def test_a_velocity_of_its_own_changes_no_weights_that_do_without() -> None:
    assert signature_hash(CerebellumConfig(), clock()) == signature_hash(CerebellumConfig(own_velocity=False), clock())
    assert "own_velocity" not in CerebellumConfig().signature(clock())
    assert signature_hash(CerebellumConfig(own_velocity=True), clock()) != signature_hash(CerebellumConfig(), clock())


def test_an_unknown_period_is_told_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match="period: there is no period `radia` under `time`; did you mean `radial`"):
        CerebellumConfig(period="radia").inputs(clock())
    with pytest.raises(ConfigError, match="no period `radia`"):
        CompensationStates(CompensationStatesConfig(period="radia"), clock())


@pytest.mark.parametrize("own_velocity", [False, True])
@pytest.mark.parametrize("nuclei", [4, 8, 16])
def test_outputs_have_the_shape_of_their_ports(nuclei: int, own_velocity: bool) -> None:
    region = cerebellum(nuclei=nuclei, own_velocity=own_velocity)
    outputs, state = region.step(spikes(region, states(3)), region.init_state(3))
    assert state == {}
    for name, port in region.output_ports.items():
        assert outputs[name].shape == (50, 3, port.channels)
        assert set(outputs[name].unique().tolist()) <= {0.0, 1.0}


def test_every_layer_fires_before_training() -> None:
    region = Cerebellum(CerebellumConfig(), clock(), torch.Generator().manual_seed(2))
    rates: dict[str, float] = {}
    values = spikes(region, states(4))
    region.step(values, {}, lambda layer, fired: rates.update({layer: fired.mean().item()}))
    assert set(rates) == {"granule", "purkinje", "nuclei", "output"}
    assert all(0.05 < rate < 0.5 for rate in rates.values())


def test_all_that_comes_out_has_passed_the_nuclei() -> None:
    region = cerebellum()
    with torch.no_grad():
        for projection in region.nuclei.projections:
            projection.weight.zero_()
    outputs, _ = region.step(spikes(region, states(16)), {})
    assert all((fired == fired[:, :1]).all() for fired in outputs.values())


def test_a_window_depends_on_nothing_but_its_inputs() -> None:
    region = cerebellum()
    with torch.no_grad():  # on the grid of shipped weights sums are exact, whatever their order
        for parameter in region.parameters():
            parameter.copy_((parameter * 1024).round() / 1024)
    values = spikes(region, states(6))
    together, _ = region.step(values, {})
    for one in range(6):
        alone, _ = region.step({name: fired[:, one : one + 1] for name, fired in values.items()}, {})
        assert all(torch.equal(alone[name], together[name][:, one : one + 1]) for name in together)


@pytest.mark.parametrize("period_ms", PERIODS_MS)
def test_states_are_reproducible_and_possible(period_ms: int) -> None:
    first, again, other = states(500, period_ms), states(500, period_ms), states(500, period_ms, seed=2)
    for name, values in first.items():
        assert values.shape == (500, 2)
        assert torch.equal(values, again[name])
        assert not torch.equal(values, other[name])
    assert (first["mean"] >= 0).all() and (first["variance"] >= 0).all()
    assert first["mean"].max() < 130 * period_ms / 1000


def test_training_brings_it_nearer_to_its_teacher_and_keeps_the_signs() -> None:
    region = cerebellum()
    teacher = PredictiveCompensator(PredictiveConfig(), clock(), torch.Generator())
    data = CompensationStates(CompensationStatesConfig(), clock())
    phase = SupervisePhase(
        region="cerebellum",
        teacher="precision.predictive",
        data="precision.compensation_states",
        loss={"move": "0.1 um", "residual": "8 mN"},
        freeze=("granule",),
        steps=80,
        batch=16,
    )

    def errors() -> Tensor:
        found = evaluate(
            region, teacher, data, torch.Generator().manual_seed(3), outputs=["move", "residual"], batches=2
        )
        return torch.cat([80 * found.rms["move"][0], found.rms["residual"][0]])

    untrained = errors()
    supervise(region, teacher, data, phase, torch.Generator().manual_seed(4))
    assert (errors() < 0.6 * untrained).all()
    inhibition, excitation = (projection.weight for projection in region.nuclei.projections)
    assert (inhibition <= 0).all() and (excitation >= 0).all()


def test_with_a_velocity_of_its_own_it_learns_the_paper_s_path() -> None:
    """The path of Eq. 14 does not end with its mean velocity, so move and velocity are two things to learn."""
    region = cerebellum(own_velocity=True)
    teacher = ProfileCompensator(ProfileConfig(), clock(), torch.Generator())
    data = CompensationStates(CompensationStatesConfig(), clock())
    wanted, _ = teacher.step(states(500), {})
    assert (wanted["velocity"] - wanted["move"]).square().mean().sqrt() > 0.1  # um/s at a period of 1 s
    phase = SupervisePhase(
        region="cerebellum",
        teacher="precision.profile",
        data="precision.compensation_states",
        loss={"move": "0.1 um", "residual": "8 mN", "velocity": "0.1 um/s"},
        freeze=("granule",),
        steps=80,
        batch=16,
    )

    def errors() -> Tensor:
        found = evaluate(region, teacher, data, torch.Generator().manual_seed(3), outputs=list(phase.loss), batches=2)
        return torch.stack([rms[0] for rms in found.rms.values()])

    untrained = errors()
    supervise(region, teacher, data, phase, torch.Generator().manual_seed(4))
    assert (errors() < 0.8 * untrained).all(), (untrained, errors())
