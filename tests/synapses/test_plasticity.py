"""Local learning rules."""

import torch

from neurorobo.synapses.plasticity import error_driven


def test_the_delta_rule_takes_its_share_of_the_error_away() -> None:
    """Of one target, one lesson leaves (1 - rate |trace|^2) of the error; members of a batch do not meet."""
    trace = torch.tensor([[1.0, 2.0, 0.0], [0.0, 1.0, 1.0]])
    weights, wanted = torch.zeros(2, 1, 3), torch.tensor([[3.0], [-1.0]])
    for lesson in range(1, 4):
        said = (weights * trace.unsqueeze(1)).sum(2)
        weights = error_driven(weights, trace, wanted - said, 0.1)
        left = wanted - (weights * trace.unsqueeze(1)).sum(2)
        torch.testing.assert_close(left, wanted * torch.tensor([[0.5], [0.8]]) ** lesson)
    assert not weights[0, 0, 2] and not weights[1, 0, 0]  # who was silent learns nothing


def test_each_target_may_have_a_trace_of_its_own() -> None:
    trace = torch.tensor([[[1.0, 0.0], [0.0, 2.0]]])
    changed = error_driven(torch.ones(1, 2, 2), trace, torch.tensor([[1.0, -1.0]]), 0.5)
    assert changed.tolist() == [[[1.5, 1.0], [1.0, 0.0]]]
