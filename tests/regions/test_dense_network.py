"""The network of plain numbers: what it computes, and that it is a region like any other."""

import pytest
import torch
from pydantic import ValidationError

from neurorobo.clock import Clock
from neurorobo.regions.dense_network import DenseNetwork
from neurorobo.regions.dense_network_config import DenseNetworkConfig
from neurorobo.testing import check_region

CLOCK = Clock.from_config({"control": "50 ms", "spike_step": "1 ms", "window": 8})
CONFIG = DenseNetworkConfig.model_validate(
    {
        "inputs": {"angle": {"unit": "rad", "width": 2, "range": "0..4 rad"}, "speed": {"unit": "1", "range": "-1..1"}},
        "outputs": {"torque": {"unit": "N*m", "range": "1..5 N*m"}, "force": {"unit": "N", "range": "-1..1 N"}},
        "hidden": [5, 4],
    }
)


def test_it_keeps_the_contract_of_regions() -> None:
    check_region(CONFIG, CLOCK)


def test_it_is_tanh_layers_on_scaled_inputs() -> None:
    region = DenseNetwork(CONFIG, CLOCK, torch.Generator().manual_seed(1))
    angle, speed = torch.tensor([[0.0, 3.0]]), torch.tensor([[0.5]])
    outputs, _ = region.step({"angle": angle, "speed": speed}, {})
    values = torch.tensor([[-1.0, 0.5, 0.5]])
    weights = [(layer.weight, layer.bias) for layer in region.layers.values()]
    for weight, bias in weights[:-1]:
        values = torch.tanh(values @ weight.T + bias)  # type: ignore[operator]
    values = values @ weights[-1][0].T + weights[-1][1]  # type: ignore[operator]
    torch.testing.assert_close(outputs["torque"], 3.0 + 2.0 * values[:, :1])
    torch.testing.assert_close(outputs["force"], values[:, 1:])


def test_it_begins_in_the_middle_of_its_ranges() -> None:
    region = DenseNetwork(CONFIG, CLOCK, torch.Generator().manual_seed(1))
    outputs, _ = region.step({"angle": torch.rand(50, 2) * 4, "speed": torch.rand(50, 1)}, {})
    torch.testing.assert_close(outputs["torque"], torch.full((50, 1), 3.0), atol=0.1, rtol=0)


def test_a_range_must_be_of_the_unit() -> None:
    with pytest.raises(ValidationError, match="'0 N' is a force"):
        DenseNetworkConfig.model_validate(
            {"inputs": {"a": {"unit": "m", "range": "0..1 N"}}, "outputs": {"b": {"unit": "1", "range": "0..1"}}}
        )
