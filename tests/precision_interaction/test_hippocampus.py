"""The spiking hippocampus: its codes, its two recurrences, its data, and that it can learn the contact law."""

import subprocess
import sys
from typing import Any

import pytest
import torch
from precision_interaction.data.insertion_speeds import InsertionSpeeds, InsertionSpeedsConfig
from precision_interaction.regions.hippocampus import Hippocampus
from precision_interaction.regions.hippocampus_config import HippocampusConfig
from precision_interaction.teachers.contact_expectation import ContactLaw
from precision_interaction.teachers.contact_expectation_config import ContactLawConfig
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.errors import ConfigError
from neurorobo.learning.evaluate import evaluate
from neurorobo.learning.phase import SupervisePhase, Unroll
from neurorobo.learning.supervise import supervise

FEEDBACK = {"mean_feedback": "mean", "variance_feedback": "variance"}


def clock(period_ms: int = 1000) -> Clock:
    return Clock({"control": 10**9, "radial": period_ms * 10**6}, 10**6, 50)


def hippocampus(period_ms: int = 1000, **options: Any) -> Hippocampus:
    config = HippocampusConfig.model_validate({"hidden_neurons": 60, **options})
    return Hippocampus(config, clock(period_ms), torch.Generator().manual_seed(1))


def windows(region: Hippocampus, speed_um_s: Tensor, count: int) -> list[dict[str, Tensor]]:
    """The outputs of windows that feed one another."""
    batch = len(speed_um_s)
    inputs = {
        name: port.code.encode(torch.zeros(batch, port.width), 50)
        for name, port in region.input_ports.items()
        if port.code
    }
    code = region.input_ports["speed"].code
    assert code is not None
    inputs["speed"] = code.encode(speed_um_s, 50)
    state, outputs = region.init_state(batch), []
    for _ in range(count):
        out, state = region.step(inputs, state)
        outputs.append(out)
        inputs |= {to: out[source] for to, source in FEEDBACK.items() if to in inputs}
    return outputs


@pytest.mark.parametrize("module", ["regions.hippocampus_config", "data.insertion_speeds"])
def test_configurations_do_not_import_torch(module: str) -> None:
    check = f"import sys, precision_interaction.{module}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


def test_the_paper_s_sizes_are_the_default() -> None:
    region = Hippocampus(HippocampusConfig(), clock(), torch.Generator())
    speed, mean, variance = region.input_ports.values()
    assert speed.channels == 50
    assert region.hidden.neurons == 343
    assert mean.channels + variance.channels == region.output.neurons == 40


@pytest.mark.parametrize("period_ms", [1000, 200, 50])
def test_the_outputs_can_be_the_next_window_s_feedback(period_ms: int) -> None:
    config = HippocampusConfig()
    inputs, outputs = config.inputs(clock(period_ms)), config.outputs(clock(period_ms))
    for target, source in FEEDBACK.items():
        assert inputs[target].code == outputs[source].code
        assert (inputs[target].unit, inputs[target].width) == (outputs[source].unit, outputs[source].width)


def test_a_shorter_period_expects_less_with_the_same_spikes_and_weights() -> None:
    slow, fast = hippocampus(1000), hippocampus(200)
    assert slow.config.signature(slow.clock) == fast.config.signature(fast.clock)
    speed_um_s = torch.tensor([[30.0], [90.0]])
    (of_slow,), (of_fast,) = windows(slow, speed_um_s, 1), windows(fast, speed_um_s, 1)
    for name in ("mean", "variance"):
        assert of_slow[name].any()
        assert of_slow[name].equal(of_fast[name])
        in_slow, in_fast = slow.output_ports[name].code, fast.output_ports[name].code
        assert in_slow is not None and in_fast is not None
        torch.testing.assert_close(in_fast.decode(of_fast[name]), in_slow.decode(of_slow[name]) / 5)


def test_what_is_trained_depends_on_the_ranges() -> None:
    wider = HippocampusConfig.model_validate({"mean_range": "0..400 mN"})
    assert wider.signature(clock()) != HippocampusConfig().signature(clock())


def test_an_unknown_period_is_refused() -> None:
    with pytest.raises(ConfigError, match="no period `fast`"):
        HippocampusConfig(period="fast").inputs(clock())


def test_no_speed_means_no_spikes() -> None:
    for out in windows(hippocampus(), torch.zeros(1, 1), 3):
        assert not out["mean"].any() and not out["variance"].any()


def test_both_recurrences_matter() -> None:
    region = hippocampus()
    speed_um_s = torch.tensor([[60.0]])
    first, second = windows(region, speed_um_s, 2)
    assert not first["mean"].equal(second["mean"])

    inner_only = hippocampus(outer=False)
    assert set(inner_only.input_ports) == {"speed"}
    state = inner_only.init_state(1)
    code = inner_only.input_ports["speed"].code
    assert code is not None
    _, carried = inner_only.step({"speed": code.encode(speed_um_s, 50)}, state)
    assert not state["hidden"].any() and carried["hidden"].any()


def test_everything_passes_the_hidden_units() -> None:
    region = hippocampus()
    with torch.no_grad():
        region.output.projections[0].weight.zero_()
    (out,) = windows(region, torch.tensor([[80.0]]), 1)
    assert not out["mean"].any() and not out["variance"].any()


def test_speeds_cover_their_range() -> None:
    data = InsertionSpeeds(InsertionSpeedsConfig.model_validate({"speed": "20..60 um/s"}), clock())
    speed_um_s = data.draw(40, torch.Generator().manual_seed(1))["speed"]
    assert speed_um_s.shape == (40, 1)
    part = (speed_um_s.flatten() - 20) // 1
    assert part.tolist() == list(range(40))  # one in every um/s


def trained_a_little(region: Hippocampus, **options: Any) -> Hippocampus:
    phase = SupervisePhase(
        region="hippocampus",
        teacher="precision.law",
        data="precision.insertion_speeds",
        loss={"mean": "1 mN", "variance": "1 mN^2"},
        unroll=Unroll(windows=2, feedback=FEEDBACK),
        steps=2,
        batch=8,
        warmup=0,
        **options,
    )
    teacher = ContactLaw(ContactLawConfig(), clock(), torch.Generator())
    data = InsertionSpeeds(InsertionSpeedsConfig(), clock())
    supervise(region, teacher, data, phase, torch.Generator().manual_seed(3))
    return region


def changed(recurrence: str, **options: Any) -> set[str]:
    """The parameters that training changes."""
    after = trained_a_little(hippocampus(recurrence=recurrence), **options).state_dict()
    return {
        name for name, value in hippocampus(recurrence=recurrence).state_dict().items() if (value != after[name]).any()
    }


def test_a_fixed_recurrence_is_not_trained_nor_are_its_thresholds() -> None:
    assert "hidden.recurrent.weight" in changed("trained")
    assert "hidden.threshold" in changed("trained")
    synapses = {f"hidden.projections.{number}.weight" for number in range(3)}
    assert changed("fixed") == {*synapses, "output.projections.0.weight"}
    assert changed("fixed", freeze=("input",)) == {"output.projections.0.weight"}  # all of the liquid as it was drawn


def test_a_fixed_recurrence_starts_as_a_trained_one_does() -> None:
    speed_um_s = torch.tensor([[60.0]])
    for fixed, trained in zip(
        windows(hippocampus(recurrence="fixed"), speed_um_s, 2), windows(hippocampus(), speed_um_s, 2), strict=True
    ):
        assert fixed["mean"].any() and fixed["mean"].equal(trained["mean"])


def test_without_inner_recurrence_hidden_neurons_do_not_hear_one_another() -> None:
    region = hippocampus(recurrence="none", outer=False)
    assert region.hidden.recurrent is None
    code = region.input_ports["speed"].code
    assert code is not None
    heard: list[Tensor] = []

    def listen(layer: str, spikes: Tensor) -> None:
        if layer == "hidden":
            heard.append(spikes.clone())

    inputs = {"speed": code.encode(torch.tensor([[60.0]]), 50)}
    region.step(inputs, region.init_state(1), listen)
    with torch.no_grad():
        region.hidden.projections[0].weight[0].zero_()  # one neuron falls silent; the others go on as before
    region.step(inputs, region.init_state(1), listen)
    before, after = heard
    assert before.any() and not after[..., 0].any()
    assert after[..., 1:].equal(before[..., 1:])


def test_weights_of_other_recurrences_do_not_fit_and_the_default_is_not_told() -> None:
    told = {name: HippocampusConfig(recurrence=name).signature(clock()) for name in ("trained", "fixed", "none")}
    assert len({str(signature) for signature in told.values()}) == 3
    assert "recurrence" not in told["trained"]  # so that weights from before there was a choice still fit
    assert HippocampusConfig.model_validate(HippocampusConfig().model_dump()) == HippocampusConfig()


def test_the_width_of_the_surrogate_changes_what_is_learnt_but_not_what_fires_nor_what_weights_fit() -> None:
    narrow, wide = hippocampus(surrogate_width=0.5), hippocampus()
    speed_um_s = torch.tensor([[60.0]])
    (before,), (same,) = windows(narrow, speed_um_s, 1), windows(wide, speed_um_s, 1)
    assert before["mean"].any() and before["mean"].equal(same["mean"])
    assert narrow.config.signature(narrow.clock) == wide.config.signature(wide.clock)
    weights = [trained_a_little(region).output.projections[0].weight for region in (narrow, wide)]
    assert not weights[0].equal(weights[1])


def test_it_learns_to_look_two_periods_ahead() -> None:
    region = hippocampus()
    teacher = ContactLaw(ContactLawConfig(), clock(), torch.Generator())
    data = InsertionSpeeds(InsertionSpeedsConfig(), clock())
    unroll = Unroll(windows=2, feedback=FEEDBACK, discount=0.9)

    def rms_mN() -> Tensor:
        generator = torch.Generator().manual_seed(2)
        return evaluate(region, teacher, data, generator, outputs=["mean"], unroll=unroll, batches=2).rms["mean"]

    phase = SupervisePhase(
        region="hippocampus",
        teacher="precision.law",
        data="precision.insertion_speeds",
        loss={"mean": "1 mN", "variance": "1 mN^2"},
        unroll=unroll,
        steps=60,
        batch=16,
        learning_rate=0.05,
    )
    before = rms_mN()
    supervise(region, teacher, data, phase, torch.Generator().manual_seed(3))
    after = rms_mN()
    assert (after < before / 2).all()
    assert (after < torch.tensor([[8.0], [16.0]])).all()  # of 0..107 mN and 0..214 mN
