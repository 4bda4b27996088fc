"""A spiking network that says numbers: trained read-outs weigh the spikes of its layers."""

from collections.abc import Mapping
from functools import cache

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.regions.readout_network_config import ReadoutConfig, ReadoutNetworkConfig
from neurorobo.regions.region import Probe, State
from neurorobo.regions.spiking_network import LayeredNetwork
from neurorobo.synapses import Dense

_PREFIX = "readout_"


class Readout(nn.Module):
    """Leaky neurons that do not fire, one for each component of a quantity: spikes -> numbers in a unit and a range.

    ``U[t] = decay U[t-1] + (1 - decay) (W s[t] + b)``, of which a reading ``x`` is taken: the last, the mean or the
    largest potential of the window. A ``rate`` is the mean without a memory, ``x = W r + b`` with the firing rates
    ``r``. What is said is the ``range`` from x = -1 to 1; beyond it saturates, while gradients flow as if it did not.

    The resolution is what one spike more, of neuron j at step t, adds: ``(hi - lo) / 2 * W[j] * k[t]``, where ``k`` is
    ``1 / steps`` of a rate, ``(1 - decay) decay**(steps - 1 - t)`` of the last potential.

    Sources: the rate is the decoder of PopSAN (Tang et al. 2020), the potential the read-out of Bellec et al. 2020.
    """

    def __init__(self, config: ReadoutConfig, sources: int, generator: torch.Generator, gain: float) -> None:
        super().__init__()
        self.takes = config.takes
        self.decay = config.decay or 0.0
        self.range = config.interval
        self.synapses = Dense(sources, config.width, generator, gain=gain)
        self.bias = nn.Parameter(torch.zeros(config.width, 1))  # of a fan-in of one, by which training scales steps

    def forward(self, spikes: Tensor, before: Tensor) -> tuple[Tensor, Tensor]:
        """Turn spikes (steps, batch, sources) and the potential before into numbers (batch, width) and the last one."""
        response, left = _leak(len(spikes), self.decay)
        current = self.synapses(spikes) + self.bias[:, 0]
        potential = torch.tensordot(response, current, dims=1) + left * before
        if self.takes == "last":
            reading = potential[-1]
        elif self.takes == "largest":
            reading = potential.amax(0)
        else:
            reading = potential.mean(0)
        reading = reading + (reading.clamp(-1, 1) - reading).detach()
        lo, hi = self.range.lo, self.range.hi
        return (lo + hi) / 2 + (hi - lo) / 2 * reading, potential[-1]


@cache
def _leak(steps: int, decay: float) -> tuple[Tensor, Tensor]:
    """Return what each step's potential has of each step's current (steps, steps), and of the window before."""
    with torch.inference_mode(False):
        time = torch.arange(steps)
        powers = torch.tensor(decay) ** torch.arange(steps + 1)
        age = time[:, None] - time
        return ((1 - decay) * powers[age.clamp(min=0)]).tril(), powers[1:, None, None]


class ReadoutNetwork(LayeredNetwork):
    """The layers of its configuration, and a read-out for each output; each is a parameter group of its name."""

    config: ReadoutNetworkConfig

    def __init__(self, config: ReadoutNetworkConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self.readouts = nn.ModuleDict()
        for name, readout in config.sends.items():
            sources = sum(config.layers[read].neurons for read in readout.reads)
            self.readouts[_PREFIX + name] = Readout(readout, sources, generator, config.gain)
        self._read = {read for readout in config.sends.values() for read in readout.reads}

    def init_state(self, batch: int) -> State:
        """Return layers and read-outs at rest."""
        potentials = {name: torch.zeros(batch, readout.width) for name, readout in self.config.sends.items()}
        return {**super().init_state(batch), **potentials}

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Run one window."""
        layers = {name: state[name] for name in self.config.layers}
        spikes, after = self.run_layers(inputs, layers, self._read, probe)
        said: dict[str, Tensor] = {}
        for name, config in self.config.sends.items():
            read = torch.cat([spikes[layer] for layer in config.reads], dim=-1)
            said[name], after[name] = self.readouts[_PREFIX + name](read, state[name])
        return said, after

    def parameter_groups(self) -> Mapping[str, nn.Module]:
        """Return the layers and the read-outs by name."""
        readouts = {name: self.readouts[_PREFIX + name] for name in self.config.sends}
        return {**super().parameter_groups(), **readouts}
