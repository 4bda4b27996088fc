"""Ports and regions: what a graph relies on."""

import pytest
import torch

from neurorobo.codes import PopulationUniform
from neurorobo.regions import Port
from neurorobo.regions.region import constrain
from neurorobo.regions.sum_config import SumConfig
from neurorobo.regions.values import initial_value
from neurorobo.synapses import Dense
from tests.regions.toys import CLOCK, net


def test_a_port_knows_its_channels() -> None:
    assert Port("mN", 3).channels == 3
    assert Port("mN", 3, PopulationUniform(5, 0.0, 1.0)).channels == 15


def test_an_initial_value_of_another_width_is_refused() -> None:
    with pytest.raises(ValueError, match="width 2 cannot start at"):
        Port("mN", 2, initial=(0.0,))


def test_an_initial_value_of_whole_numbers_is_one_of_floats() -> None:
    start = initial_value(Port("mN", 2, initial=(0, 3)), batch=4, steps=20, generators=())
    assert start.dtype == torch.float32
    assert start.tolist() == [[0.0, 3.0]] * 4


def test_constrain_keeps_trained_thresholds_positive() -> None:
    region = net()
    assert region.hidden.threshold is not None
    with torch.no_grad():
        region.hidden.threshold.neg_()
    constrain(region)
    assert (region.hidden.threshold > 0).all()


def test_constrain_restores_every_sign_in_the_region() -> None:
    region = net()
    with torch.no_grad():
        for parameter in region.parameters():
            parameter.neg_()
    constrain(region)
    signed = [projection for projection in region.projections() if projection.sign]
    assert len(signed) == 3
    assert all((projection.weight == 0).all() for projection in signed)
    assert isinstance(region.hidden.recurrent, Dense)
    assert (region.hidden.recurrent.weight != 0).all()


def test_the_parts_of_a_region_can_be_trained_by_name() -> None:
    assert set(net().parameter_groups()) == {"hidden", "output"}


def test_the_sum_adds_component_by_component() -> None:
    from neurorobo.regions.sum import Sum

    config = SumConfig(unit="mN", width=2)
    region = Sum(config, CLOCK, torch.Generator())
    outputs, _ = region.step({"a": torch.tensor([[1.0, 2.0]]), "b": torch.tensor([[0.5, -2.0]])}, {})
    assert outputs["sum"].tolist() == [[1.5, 0.0]]
    assert config.outputs(CLOCK)["sum"].channels == 2
