"""Codes whose spikes are laid out by component: none of them, and no member of a batch, knows of the others."""

import pytest
import torch

from neurorobo.codes import Code
from neurorobo.codes.population_signed import PopulationSigned
from neurorobo.codes.rank_order import RankOrder


@pytest.mark.parametrize("code", [PopulationSigned(4, -1.0, 1.0), RankOrder(4, -1.0, 1.0)])
def test_each_component_and_each_member_of_a_batch_is_apart(code: Code) -> None:
    for dtype in (torch.float32, torch.float64):
        values = torch.tensor([[-0.7, 0.1, 0.9], [0.3, -0.2, -1.0]], dtype=dtype)
        spikes = code.encode(values, 20)
        assert spikes.shape == (20, 2, 12)
        assert spikes.dtype == code.decode(spikes).dtype == dtype
        alone = [code.encode(values[:, i : i + 1], 20) for i in range(3)]
        assert torch.equal(spikes, torch.cat(alone, dim=-1))
    for shape in ((0, 2), (2, 0)):
        assert code.decode(code.encode(torch.zeros(shape), 5)).shape == shape
