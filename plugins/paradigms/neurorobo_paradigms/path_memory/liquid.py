"""A liquid state machine's liquid.

Source: Maass, Natschlaeger & Markram 2002; the random recurrent network of which only the read-out is trained. Its
wiring is uniform here, where theirs falls off with distance, and its synapses are static, where theirs are dynamic.
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.regions.region import Probe, Region, State
from neurorobo.regions.weights import to_grid
from neurorobo_paradigms.path_memory.liquid_config import LiquidConfig

BITS = 12
"""Weights are multiples of 2**-12, so that sums of spikes are exact."""


class Liquid(Region):
    """LIF neurons, excitatory and inhibitory ones, with sparse random synapses that stay as they were drawn.

    At each step, with the decays m of membranes and c of currents:

        current = c current + (1 - c) R last_spikes
        potential = m potential (1 - last_spikes) + W inputs + current
        spikes = potential >= 1

    State: `potential`, `current` and `spikes`, each (batch, neurons).
    """

    config: LiquidConfig

    def __init__(self, config: LiquidConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        channels = sum(port.channels for port in self.input_ports.values())
        self.input_weight = nn.Parameter(
            _sparse(config.neurons, channels, config.input_fan_in, config.input_strength, generator)
        )
        recurrent = _sparse(config.neurons, config.neurons, config.fan_in, config.recurrent_strength, generator)
        inhibitory = torch.arange(config.neurons) >= round((1 - config.inhibitory) * config.neurons)
        self.recurrent_weight = nn.Parameter(
            to_grid(torch.where(inhibitory, -config.inhibition, 1.0) * recurrent, BITS)
        )
        self._membrane = math.exp(-clock.spike_step_ns / config.membrane)
        self._synapses = math.exp(-clock.spike_step_ns / config.synapses)

    def init_state(self, batch: int) -> State:
        """Return the state at rest."""
        return {name: torch.zeros(batch, self.config.neurons) for name in ("potential", "current", "spikes")}

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Run one window."""
        driven = torch.cat([inputs[name] for name in self.input_ports], dim=2) @ self.input_weight.t()
        recurrent, window = self.recurrent_weight.t(), []
        potential, current, spikes = state["potential"], state["current"], state["spikes"]
        for drive in driven:
            current = self._synapses * current + (1 - self._synapses) * (spikes @ recurrent)
            potential = self._membrane * potential * (1 - spikes) + drive + current
            spikes = (potential >= 1).to(potential.dtype)
            window.append(spikes)
        fired = torch.stack(window)
        if probe is not None:
            probe("liquid", fired)
        return {"spikes": fired}, {"potential": potential, "current": current, "spikes": spikes}


def _sparse(targets: int, sources: int, fan_in: int, strength: float, generator: torch.Generator) -> Tensor:
    """Draw weights (targets, sources): of each target ``fan_in`` positive ones, half-normal, the others zero."""
    heard = torch.rand(targets, sources, generator=generator).argsort(1).argsort(1) < fan_in
    weight = torch.randn(targets, sources, generator=generator).abs() * (strength / fan_in**0.5)
    return to_grid(weight * heard, BITS)
