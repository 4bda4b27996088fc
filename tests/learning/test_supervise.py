"""Supervised learning: what it promises about results, interruptions, units and what it leaves alone."""

import signal
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.codes import Poisson, PopulationUniform, TimeToFirstSpike
from neurorobo.engine import Layer
from neurorobo.errors import ConfigError, NeuroroboError
from neurorobo.learning.checkpoint import Checkpoints
from neurorobo.learning.evaluate import evaluate
from neurorobo.learning.phase import SupervisePhase, Unroll
from neurorobo.learning.supervise import Progress, supervise
from neurorobo.neurons import LIF
from neurorobo.regions.config import RegionConfig
from neurorobo.regions.port import Port
from neurorobo.regions.region import Probe, Region, State
from neurorobo.synapses import Dense

CLOCK = Clock({"control": 1_000_000_000}, 1_000_000, 20)


class SpikingConfig(RegionConfig):
    implementation: ClassVar[str] = "none"
    type: str = "spiking"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"x": Port("mN", 2, PopulationUniform(6, -1.0, 1.0))}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"y": Port("um", 2, PopulationUniform(5, -1.0, 1.0))}


class Spiking(Region):
    def __init__(self, config: RegionConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self.hidden = Layer([Dense(12, 40, generator)], LIF())
        self.output = Layer([Dense(40, 10, generator, sign="excitatory")], LIF())

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        batch = inputs["x"].shape[1]
        hidden, _ = self.hidden([inputs["x"]], self.hidden.at_rest(batch))
        output, _ = self.output([hidden], self.output.at_rest(batch))
        if probe is not None:
            probe("hidden", hidden)
            probe("output", output)
        return {"y": output}, state


class NumbersConfig(RegionConfig):
    implementation: ClassVar[str] = "none"
    type: str = "numbers"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"x": Port("mN", 2), "before": Port("um", 2, initial=(0.0, 0.0))}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"y": Port("um", 2)}


class Numbers(Region):
    """y = gain * x + before."""

    def __init__(self, gain: float, carry: str = "never") -> None:
        config = NumbersConfig.model_validate({"carry": carry})
        super().__init__(config, CLOCK, torch.Generator())
        self.gain = nn.ParameterDict({"value": nn.Parameter(torch.tensor([gain]))})

    def init_state(self, batch: int) -> State:
        return {"uses": torch.zeros(batch)}

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        y = self.gain["value"] * inputs["x"] + inputs["before"] + 100 * state["uses"].unsqueeze(1)
        return {"y": y}, {"uses": state["uses"] + 1}


class EvenData:
    def draw(self, batch: int, generator: torch.Generator) -> dict[str, Tensor]:
        return {"x": torch.rand(batch, 2, generator=generator) * 2 - 1}


def spiking() -> Spiking:
    return Spiking(SpikingConfig(), CLOCK, torch.Generator().manual_seed(1))


def phase(**settings: Any) -> SupervisePhase:
    given = {"region": "cortex", "teacher": "numbers", "data": {"type": "even"}, "loss": {"y": "0.1 um"}}
    return SupervisePhase.model_validate({**given, "steps": 20, "batch": 8, **settings})


def train(region: Region, settings: SupervisePhase, teacher: Region | None = None, **options: Any) -> None:
    supervise(region, teacher or Numbers(0.5), EvenData(), settings, torch.Generator().manual_seed(2), **options)


def rms(region: Region) -> float:
    found = evaluate(region, Numbers(0.5), EvenData(), torch.Generator().manual_seed(3), outputs=["y"])
    return float(found.rms["y"].max())


def weights(region: Region) -> dict[str, Tensor]:
    return {name: tensor.clone() for name, tensor in region.state_dict().items()}


def changed(before: Mapping[str, Tensor], after: Mapping[str, Tensor]) -> set[str]:
    return {name.partition(".")[0] for name in before if not torch.equal(before[name], after[name])}


@pytest.mark.parametrize("precision", ["float32", "bf16"])
def test_a_spiking_region_learns_what_its_teacher_does(precision: str) -> None:
    region = spiking()
    untrained = rms(region)
    train(region, phase(steps=200, batch=32, precision=precision))
    assert rms(region) < untrained / 4


def test_signs_hold_after_training() -> None:
    region = spiking()
    train(region, phase(learning_rate=1.0))
    weight = region.output.projections[0].weight
    assert (weight == 0).any() and (weight >= 0).all()


def interrupt_at(step: int) -> Callable[[Progress], None]:
    def report(progress: Progress) -> None:
        if progress.done == step:
            signal.raise_signal(signal.SIGINT)

    return report


def test_an_interrupted_phase_ends_with_the_very_same_weights(tmp_path: Path) -> None:
    straight, broken = spiking(), spiking()
    train(straight, phase(steps=12))
    checkpoints = Checkpoints(tmp_path / "run" / "phase.safetensors")
    for step in (5, 9):
        with pytest.raises(KeyboardInterrupt):
            train(broken, phase(steps=12), report=interrupt_at(step), checkpoints=checkpoints)
        broken = Spiking(SpikingConfig(), CLOCK, torch.Generator().manual_seed(99))  # a new process knows only the file
    seen: list[int] = []
    train(broken, phase(steps=12), report=lambda progress: seen.append(progress.done), checkpoints=checkpoints)
    assert seen == [10, 11, 12]
    assert not changed(weights(straight), weights(broken))
    assert list(checkpoints.file.parent.iterdir()) == [checkpoints.file]  # for the caller to remove


def test_weights_that_the_loss_does_not_depend_on_stay_as_they_are_and_prevent_no_resuming(tmp_path: Path) -> None:
    class Idle(Spiking):
        def __init__(self) -> None:
            super().__init__(SpikingConfig(), CLOCK, torch.Generator().manual_seed(1))
            self.idle = Layer([Dense(40, 3, torch.Generator().manual_seed(1))], LIF())

    checkpoints = Checkpoints(tmp_path / "phase.safetensors")
    with pytest.raises(KeyboardInterrupt):
        train(Idle(), phase(steps=6), report=interrupt_at(3), checkpoints=checkpoints)
    straight, broken = Idle(), Idle()
    train(straight, phase(steps=6))
    train(broken, phase(steps=6), checkpoints=checkpoints)
    assert not changed(weights(straight), weights(broken))
    assert changed(weights(straight), weights(Idle())) == {"hidden", "output"}


def test_noise_on_the_weights_acts_while_gradients_are_taken_and_leaves_no_trace(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    region, seen = spiking(), []
    region.output.projections[0].weight.data[0] = 0.0
    before, step = weights(region), region.step

    def watched(*arguments: Any) -> Any:
        seen.append(weights(region))
        return step(*arguments)

    monkeypatch.setattr(region, "step", watched)
    train(region, phase(steps=2, learning_rate=1e-30, weight_noise=0.1))
    assert not changed(before, weights(region))
    assert changed(before, seen[0]) == changed(seen[0], seen[1]) == {"hidden", "output"}
    assert all((noisy["output.projections.0.weight"] >= 0).all() for noisy in seen)  # Dale's law holds under noise

    def broken(*arguments: Any) -> Any:
        raise RuntimeError("broken")

    monkeypatch.setattr(region, "step", broken)
    with pytest.raises(RuntimeError, match="broken"):
        train(region, phase(weight_noise=0.1))
    assert not changed(before, weights(region))


class Loop:
    """A closed loop in which the region meets what it would say of one input for each seed."""

    def __init__(self, region: Region, others: str = "as they were") -> None:
        self.region, self.others = region, others

    def fingerprint(self) -> str:
        return self.others

    def __call__(self, seeds: Sequence[int]) -> dict[str, Tensor]:
        generator = torch.Generator().manual_seed(sum(seeds))
        x = torch.rand(len(seeds), 2, generator=generator) * 2 - 1
        code = self.region.output_ports["y"].code
        assert code is not None
        spikes = PopulationUniform(6, -1.0, 1.0).encode(x, 20)
        return {"x": code.decode(self.region.step({"x": spikes}, {})[0]["y"]).detach()}


def test_also_one_that_learns_from_what_it_meets(tmp_path: Path) -> None:
    settings = phase(steps=12, on_policy={"share": 0.5, "episodes": 3, "every": 4}, weight_noise=0.01)
    straight, broken = spiking(), spiking()
    train(straight, settings, rollout=Loop(straight))
    checkpoints = Checkpoints(tmp_path / "phase.safetensors")
    with pytest.raises(KeyboardInterrupt):
        train(broken, settings, report=interrupt_at(6), checkpoints=checkpoints, rollout=Loop(broken))
    broken = spiking()
    with pytest.raises(NeuroroboError, match="another training: the rest of the closed loop differ"):
        train(broken, settings, checkpoints=checkpoints, rollout=Loop(broken, "others"))
    train(broken, settings, checkpoints=checkpoints, rollout=Loop(broken))
    assert not changed(weights(straight), weights(broken))
    with pytest.raises(ValueError, match="needs a rollout"):
        train(spiking(), settings)


def test_checkpoints_are_also_written_on_the_way(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path / "phase.safetensors", every_s=0)

    def fail(progress: Progress) -> None:
        if progress.done == 7:
            raise RuntimeError("power cut")

    with pytest.raises(RuntimeError):
        train(spiking(), phase(), report=fail, checkpoints=checkpoints)
    seen: list[int] = []
    train(spiking(), phase(), report=lambda progress: seen.append(progress.done), checkpoints=checkpoints)
    assert seen[0] == 7


def test_ctrl_c_is_python_s_again_afterwards(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    train(spiking(), phase(steps=1))
    assert signal.getsignal(signal.SIGINT) is before


def test_a_checkpoint_of_another_phase_is_refused(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path / "phase.safetensors")
    with pytest.raises(KeyboardInterrupt):
        train(spiking(), phase(), report=interrupt_at(3), checkpoints=checkpoints)
    with pytest.raises(NeuroroboError, match="another training: the settings of the phase differ; remove it"):
        train(spiking(), phase(seed=5), checkpoints=checkpoints)


def test_a_checkpoint_of_another_region_clock_or_past_is_refused(tmp_path: Path) -> None:
    class Wide(SpikingConfig):
        type: str = "wide"

    checkpoints = Checkpoints(tmp_path / "phase.safetensors")
    with pytest.raises(KeyboardInterrupt):
        train(spiking(), phase(), report=interrupt_at(3), checkpoints=checkpoints)
    later = Clock({"control": 2_000_000_000}, 1_000_000, 20)
    generator = torch.Generator()
    for region, words in (
        (Spiking(Wide(), CLOCK, generator), "the configuration of the region"),
        (Spiking(SpikingConfig(), later, generator), "the clock"),
    ):
        with pytest.raises(NeuroroboError, match=f"another training: {words} differ; remove it"):
            train(region, phase(), checkpoints=checkpoints)
    with pytest.raises(NeuroroboError, match="the weights of the phase before differ"):
        train(spiking(), phase(), checkpoints=Checkpoints(checkpoints.file, after="0123"))


def test_a_checkpoint_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    checkpoints = Checkpoints(tmp_path / "file" / "phase.safetensors", every_s=0)
    with pytest.raises(NeuroroboError, match=r"phase.safetensors cannot be written .*; make room"):
        train(spiking(), phase(), checkpoints=checkpoints)


class PoissonConfig(SpikingConfig):
    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"x": Port("mN", 2, Poisson(6, -1.0, 1.0))}


class LatencyConfig(SpikingConfig):
    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"y": Port("um", 2, TimeToFirstSpike(5, -1.0, 1.0))}


def test_a_region_can_be_taught_what_it_hears_in_random_spikes_drawn_from_the_phase_s_generator() -> None:
    trained = []
    for _ in range(2):
        region = Spiking(PoissonConfig(), CLOCK, torch.Generator().manual_seed(1))
        before = rms(region)
        train(region, phase(steps=60))
        assert rms(region) < 0.7 * before
        trained.append(weights(region))
    assert not changed(*trained)


def test_what_is_said_in_a_code_without_gradient_cannot_be_taught() -> None:
    region = Spiking(LatencyConfig(), CLOCK, torch.Generator().manual_seed(1))
    with pytest.raises(ConfigError) as raised:
        train(region, phase())
    (fault,) = raised.value.faults
    assert fault.path == ("loss", "y")
    assert "the code of `y`, TimeToFirstSpike, which has no gradient; give it one" in fault.message


def test_a_file_that_is_no_checkpoint_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "phase.safetensors"
    file.write_bytes(b"nonsense")
    with pytest.raises(NeuroroboError, match="not a checkpoint"):
        train(spiking(), phase(), checkpoints=Checkpoints(file))


@pytest.mark.parametrize(
    ("settings", "trained"),
    [({}, {"hidden", "output"}), ({"train": ["output"]}, {"output"}), ({"freeze": ["output"]}, {"hidden"})],
)
def test_only_the_groups_of_the_phase_change(settings: dict[str, Any], trained: set[str]) -> None:
    region = spiking()
    before = weights(region)
    train(region, phase(**settings))
    assert changed(before, weights(region)) == trained
    assert all(parameter.requires_grad and parameter.grad is None for parameter in region.parameters())


def test_unknown_groups_are_refused() -> None:
    with pytest.raises(NeuroroboError, match="no parameter group `outputs`; did you mean `output`"):
        train(spiking(), phase(train=["outputs"]))
    with pytest.raises(NeuroroboError, match="freezes all"):
        train(spiking(), phase(freeze=["hidden", "output"]))


@pytest.mark.parametrize(
    ("settings", "path", "message"),
    [
        ({"loss": {"z": "1 um"}}, ("loss", "z"), "no output `z`"),
        ({"loss": {"y": "1 mN"}}, ("loss", "y"), "a length"),
        ({"loss": {"y": "0 um"}}, ("loss", "y"), "above zero"),
        ({"unroll": {"windows": 2, "feedback": {"b": "y"}}}, ("unroll", "feedback", "b"), "no input `b`"),
        ({"unroll": {"windows": 2, "feedback": {"x": "z"}}}, ("unroll", "feedback", "x"), "no output `z`"),
        ({"unroll": {"windows": 2, "feedback": {"x": "y"}}}, ("unroll", "feedback", "x"), "differ in unit"),
    ],
)
def test_what_does_not_fit_the_region_is_told_with_its_place(
    settings: dict[str, Any], path: tuple[str, ...], message: str
) -> None:
    with pytest.raises(ConfigError) as raised:
        train(spiking(), phase(**settings))
    (fault,) = raised.value.faults
    assert fault.path == path
    assert message in fault.message


def test_missing_data_are_named() -> None:
    class Nothing:
        def draw(self, batch: int, generator: torch.Generator) -> dict[str, Tensor]:
            return {"y": torch.zeros(batch, 2)}

    with pytest.raises(NeuroroboError, match="nothing for the input `x`"):
        supervise(spiking(), Numbers(1.0), Nothing(), phase(), torch.Generator())


def test_unrolled_errors_are_those_of_both_chains() -> None:
    # Fed back, y grows by gain * x per window; so do the errors: (2 - 0.5) * x * (1, 2, 3).
    unroll = Unroll(windows=3, feedback={"before": "y"})
    generator = torch.Generator().manual_seed(4)
    x = EvenData().draw(16, torch.Generator().manual_seed(4))["x"]
    found = evaluate(
        Numbers(2.0), Numbers(0.5), EvenData(), generator, outputs=["y"], unroll=unroll, batch=16, batches=1
    )
    one = 1.5 * x.square().mean(0).sqrt()
    torch.testing.assert_close(found.rms["y"], torch.stack([one, 2 * one, 3 * one]))
    torch.testing.assert_close(found.largest["y"][2], 4.5 * x.abs().amax(0))
    torch.testing.assert_close(found.bias["y"][0], 1.5 * x.mean(0))


def test_a_carried_state_lives_through_the_windows_and_no_other_does() -> None:
    unroll = Unroll(windows=2)
    errors = []
    for carry in ("never", "repeat"):
        found = evaluate(
            Numbers(0.5, carry), Numbers(0.5), EvenData(), torch.Generator(), outputs=["y"], unroll=unroll, batches=1
        )
        errors.append(found.bias["y"].mean(1).tolist())
    assert errors == [[0.0, 0.0], [0.0, 100.0]]


def test_the_loss_counts_errors_in_their_unit_and_discounts_windows() -> None:
    losses: list[float] = []
    unroll = {"windows": 2, "feedback": {"before": "y"}, "discount": 0.5}
    settings = phase(steps=1, loss={"y": "500 nm"}, unroll=unroll)
    train(Numbers(2.0), settings, report=lambda progress: losses.append(progress.loss))
    x = EvenData().draw(8, torch.Generator().manual_seed(2))["x"]
    one = float((1.5 * x / 0.5).square().mean())
    assert losses == [pytest.approx(one + 0.5 * 4 * one)]


def test_a_rate_penalty_makes_the_region_quieter() -> None:
    rates = []
    for penalty in (0.0, 1000.0):
        region = spiking()
        train(region, phase(steps=100, rate_penalty=penalty))
        found = evaluate(region, Numbers(0.5), EvenData(), torch.Generator(), outputs=["y"], batches=2)
        rates.append(found.rates["hidden"])
    assert rates[1] < 0.8 * rates[0]


def test_targets_beyond_the_code_are_what_it_can_say() -> None:
    loud = evaluate(spiking(), Numbers(100.0), EvenData(), torch.Generator(), outputs=["y"])
    assert float(loud.largest["y"].max()) <= 2.0


def test_the_precision_of_products_is_restored() -> None:
    matmul = torch.backends.mkldnn.matmul
    before = matmul.fp32_precision
    seen: list[str] = []
    train(spiking(), phase(steps=1, precision="bf16"), report=lambda _: seen.append(matmul.fp32_precision))
    assert seen == ["bf16"]
    assert matmul.fp32_precision == before


@pytest.mark.parametrize("schedule", ["linear", "cosine"])
def test_the_learning_rate_rises_to_its_peak_and_falls_to_zero(schedule: str) -> None:
    settings = phase(steps=1000, warmup=10, learning_rate=0.1, schedule=schedule)
    rates = [settings.learning_rate_at(step) for step in range(1000)]
    assert rates[0] == pytest.approx(0.01)
    assert max(rates) == pytest.approx(0.1, rel=0.02)
    assert rates.index(max(rates)) == 9
    assert rates[500] == pytest.approx(0.05, rel=0.02)
    assert rates[-1] < 0.001
