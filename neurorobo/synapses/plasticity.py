"""Local learning rules: what changes a synapse is known at its two ends, or broadcast."""

from torch import Tensor


def error_driven(weights: Tensor, trace: Tensor, error: Tensor, rate: float) -> Tensor:
    """Return weights changed by ``rate * error * trace``: the delta rule, with the error from a third party.

    ``weights`` (batch, targets, sources) differ from member to member; ``trace`` is what the sources did, (batch,
    sources) or one for each target (batch, targets, sources); ``error`` (batch, targets) is positive where more is
    wanted. Source: Widrow & Hoff 1960; for synapses with a modulator, Fremaux & Gerstner 2016, Eq. 3.
    """
    if trace.dim() == 2:
        trace = trace.unsqueeze(1)
    return weights + rate * error.unsqueeze(2) * trace
