from typing import ClassVar, Literal

from neurorobo.codes import PopulationUniform
from neurorobo.plugins import hookimpl
from neurorobo.regions import Port, RegionConfig


class EchoConfig(RegionConfig):
    """Answers a rate with a rate, through one layer of spiking neurons; the network is in region.py."""

    implementation: ClassVar[str] = "neurorobo_minimal.region:Echo"
    type: Literal["minimal.echo"] = "minimal.echo"
    neurons: int = 20

    def inputs(self, clock):
        return {"heard": Port("Hz", code=PopulationUniform(self.neurons, 0, 100), initial=(40.0,))}

    def outputs(self, clock):
        return {"said": Port("Hz", code=PopulationUniform(self.neurons, 0, 100))}


@hookimpl
def neurorobo_register(registry):
    registry.add("region", "minimal.echo", "neurorobo_minimal.plugin:EchoConfig", "answers a rate with a rate")
