from neurorobo.engine import Layer
from neurorobo.neurons import LIF
from neurorobo.regions.region import Region
from neurorobo.synapses import Dense


class Echo(Region):
    def __init__(self, config, clock, generator):
        super().__init__(config, clock, generator)
        self.layer = Layer([Dense(config.neurons, config.neurons, generator, gain=2.0)], LIF())

    def step(self, inputs, state, probe=None):
        said, _ = self.layer([inputs["heard"]])
        if probe is not None:
            probe("layer", said)
        return {"said": said}, state
