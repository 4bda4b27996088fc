"""The spiking prefrontal cortex: its layers and blocks, its data, and that it can learn from the planner."""

import subprocess
import sys
from typing import Any

import pytest
import torch
from precision_interaction.data.planning_states import PlanningStates, PlanningStatesConfig
from precision_interaction.regions.prefrontal_cortex import PrefrontalCortex
from precision_interaction.regions.prefrontal_cortex_config import PrefrontalCortexConfig
from precision_interaction.teachers.planner import AxialPlanner, stopping_speed
from precision_interaction.teachers.planner_config import PlannerConfig
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.errors import ConfigError
from neurorobo.learning.evaluate import evaluate
from neurorobo.learning.phase import SupervisePhase
from neurorobo.learning.supervise import supervise

CLOCK = Clock({"control": 10**9}, 10**6, 50)
SMALL = {"prediction_neurons": 40, "terminal_neurons": 30, "general_neurons": 40, "hidden_neurons": (80, 40)}
INPUTS = ("force", "forecast", "variance", "remaining", "speed", "beta")


def cortex(**options: Any) -> PrefrontalCortex:
    config = PrefrontalCortexConfig.model_validate({**SMALL, **options})
    return PrefrontalCortex(config, CLOCK, torch.Generator().manual_seed(1))


def states(batch: int, seed: int = 1, **options: Any) -> dict[str, Tensor]:
    data = PlanningStates(PlanningStatesConfig.model_validate(options), CLOCK)
    return data.draw(batch, torch.Generator().manual_seed(seed))


def plan(region: PrefrontalCortex, values: dict[str, Tensor]) -> dict[str, Tensor]:
    inputs = {name: port.code.encode(values[name], 50) for name, port in region.input_ports.items() if port.code}
    with torch.no_grad():
        return region.step(inputs, region.init_state(len(values["speed"])))[0]


@pytest.mark.parametrize("module", ["regions.prefrontal_cortex_config", "data.planning_states"])
def test_configurations_do_not_import_torch(module: str) -> None:
    check = f"import sys, precision_interaction.{module}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


def test_the_paper_s_sizes_are_the_default() -> None:
    region = PrefrontalCortex(PrefrontalCortexConfig(), CLOCK, torch.Generator())
    assert tuple(region.input_ports) == INPUTS
    assert sum(port.channels for port in region.input_ports.values()) == 64
    fired: dict[str, int] = {}
    inputs = {name: torch.zeros(50, 1, port.channels) for name, port in region.input_ports.items()}
    region.step(inputs, {}, lambda layer, spikes: fired.update({layer: spikes.shape[-1]}))
    second, rest = list(fired.values())[:3], list(fired.values())[3:]  # the second layer is made of three parts
    assert [sum(second), *rest] == [256, 512, 512, 128, 4]


@pytest.mark.parametrize(
    ("value", "read"), [("confidence", {"forecast", "variance"}), ("terminal", {"remaining", "speed"})]
)
def test_a_block_reads_nothing_but_its_own_inputs(value: str, read: set[str]) -> None:
    region = cortex()
    values, others = states(20, 1), states(20, 2)
    before = plan(region, values)[value]
    for name in INPUTS:
        after = plan(region, {**values, name: others[name]})[value]
        assert after.equal(before) == (name not in read), name


def test_everything_passes_every_layer() -> None:
    for layer in range(3):
        region = cortex()
        with torch.no_grad():
            region.later[layer].projections[0].weight.zero_()
        out = plan(region, states(5))
        assert not out["speed"].any() and not out["beta"].any()


def test_it_starts_from_creep_speed_and_the_paper_s_beta() -> None:
    ports = PrefrontalCortexConfig.model_validate({"start_speed": "5 um/s"}).inputs(CLOCK)
    assert (ports["speed"].initial, ports["beta"].initial) == ((5.0,), (0.3,))
    assert PrefrontalCortexConfig(beta_0=0.5).signature(CLOCK) == PrefrontalCortexConfig().signature(CLOCK)


def test_weights_belong_to_the_length_of_the_axial_period_not_to_its_name() -> None:
    def signature(seconds: int, period: str = "control") -> object:
        return PrefrontalCortexConfig(period=period).signature(
            Clock({"control": 2 * 10**9, "axial": seconds * 10**9}, 10**6, 50)
        )

    assert signature(1, "axial") != signature(2, "axial") == signature(2, "control")
    with pytest.raises(ConfigError, match="period: there is no period `radial`"):
        PrefrontalCortexConfig(period="radial").inputs(CLOCK)


def test_states_lie_within_the_codes_and_gather_where_one_brakes() -> None:
    values = states(4000)
    for name, port in PrefrontalCortexConfig().inputs(CLOCK).items():
        assert values[name].shape == (4000, port.width)
        assert port.code is not None
        assert port.code.saturated(values[name]).float().mean() < 0.02, name
    braking = values["remaining"] < 300
    assert braking.float().mean() > 0.4
    from_the_chain_um_s = (values["speed"] - stopping_speed(values["remaining"])).abs()
    assert (from_the_chain_um_s[braking] < 25).float().mean() > 0.5


def test_states_off_the_policy_are_spread_evenly() -> None:
    values = states(4000, off_policy=1.0)
    for name, largest in (("force", 60.0), ("forecast", 60.0)):
        assert values[name].abs().max() <= largest
        assert values[name].std(0).tolist() == pytest.approx([largest / 3**0.5] * 2, rel=0.05)


def test_blocks_first_then_the_rest_with_the_blocks_frozen() -> None:
    region = cortex()
    teacher = AxialPlanner(PlannerConfig(), CLOCK, torch.Generator())
    data = PlanningStates(PlanningStatesConfig(off_policy=0.2), CLOCK)

    def rms() -> dict[str, float]:
        generator, outputs = torch.Generator().manual_seed(2), ["confidence", "terminal", "speed", "beta"]
        compared = evaluate(region, teacher, data, generator, outputs=outputs, batches=4)
        return {name: float(error) for name, error in compared.rms.items()}

    common: dict[str, Any] = {
        "region": "prefrontal_cortex",
        "teacher": "precision.planner",
        "data": {"type": "precision.planning_states", "off_policy": 0.2},
        "steps": 60,
        "batch": 32,
    }
    blocks = SupervisePhase(
        **common,
        loss={"confidence": "0.1", "terminal": "0.1"},
        train=("prediction", "terminal"),
        learning_rate=0.2,
    )
    rest = SupervisePhase(
        **common, loss={"speed": "1 um/s", "beta": "0.03"}, freeze=("prediction", "terminal"), learning_rate=0.03
    )
    fresh = rms()
    supervise(region, teacher, data, blocks, torch.Generator().manual_seed(3))
    after_blocks = rms()
    assert after_blocks["confidence"] < 0.6 * fresh["confidence"]
    assert after_blocks["terminal"] < 0.6 * fresh["terminal"]
    supervise(region, teacher, data, rest, torch.Generator().manual_seed(4))
    after = rms()
    assert (after["confidence"], after["terminal"]) == (after_blocks["confidence"], after_blocks["terminal"])
    assert after["speed"] < fresh["speed"] / 4
    assert after["beta"] < 0.8 * fresh["beta"]
