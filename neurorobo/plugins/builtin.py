"""The core's own types, registered as any plugin registers its types."""

from neurorobo.plugins.hookspec import hookimpl
from neurorobo.plugins.registry import Registrar


@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    """Register the types of the core under the prefix ``core``."""
    registry.add("region", "core.sum", "neurorobo.regions.sum_config:SumConfig", "adds two quantities of one unit")
    registry.add(
        "region",
        "core.feedforward",
        "neurorobo.regions.feedforward_config:FeedforwardConfig",
        "spiking layers from any inputs to any outputs, of any neuron and code",
    )
    registry.add(
        "region",
        "core.spiking_network",
        "neurorobo.regions.spiking_network_config:NetworkConfig",
        "spiking layers by name, each of its own neurons and sources, recurrent or not",
    )
    registry.add(
        "region",
        "core.readout_network",
        "neurorobo.regions.readout_network_config:ReadoutNetworkConfig",
        "spiking layers by name, read out as numbers by trained weights",
    )
    registry.add(
        "region",
        "core.delta_encoder",
        "neurorobo.regions.delta_config:DeltaEncoderConfig",
        "says in ON and OFF spikes what changes, one for each threshold",
    )
    registry.add(
        "region",
        "core.delta_decoder",
        "neurorobo.regions.delta_config:DeltaDecoderConfig",
        "adds up the changes that a delta_encoder sends",
    )
    registry.add(
        "region",
        "core.plastic_network",
        "neurorobo.regions.plastic_network_config:PlasticNetworkConfig",
        "a spiking network whose synapses learn by local rules while it runs",
    )
    registry.add(
        "region",
        "core.dense_network",
        "neurorobo.regions.dense_network_config:DenseNetworkConfig",
        "layers of units without spikes, to compare spiking ones with",
    )
    registry.add(
        "body",
        "core.gymnasium_environment",
        "neurorobo.bodies.gymnasium_body_config:GymnasiumBodyConfig",
        "any Gymnasium environment, its elements named as sensors and actuators",
    )
    registry.add(
        "task",
        "core.gymnasium_reward",
        "neurorobo.tasks.gymnasium_task_config:GymnasiumTaskConfig",
        "the reward and the end of a Gymnasium environment",
    )
    registry.add("neuron", "core.lif", "neurorobo.neurons.config:LIFConfig", "leaky integrate-and-fire, iterative")
    registry.add(
        "neuron",
        "core.spiking_neural_unit",
        "neurorobo.neurons.config:SpikingNeuralUnitConfig",
        "integrate-and-fire whose potential is rectified",
    )
    registry.add(
        "neuron",
        "core.soft_spiking_neural_unit",
        "neurorobo.neurons.config:SoftSpikingNeuralUnitConfig",
        "a spiking neural unit that sends numbers between 0 and 1, for hidden layers",
    )
    registry.add(
        "neuron",
        "core.integrate_and_fire",
        "neurorobo.neurons.generalized_lif_config:IntegrateAndFireConfig",
        "integrate-and-fire without a leak",
    )
    registry.add(
        "neuron",
        "core.exact_lif",
        "neurorobo.neurons.generalized_lif_config:ExactLIFConfig",
        "leaky integrate-and-fire with a time constant, integrated exactly",
    )
    registry.add(
        "neuron",
        "core.synaptic_lif",
        "neurorobo.neurons.generalized_lif_config:SynapticLIFConfig",
        "exact_lif with an exponential synaptic current",
    )
    registry.add(
        "neuron",
        "core.adaptive_lif",
        "neurorobo.neurons.generalized_lif_config:AdaptiveLIFConfig",
        "exact_lif whose threshold rises with its spikes and falls back",
    )
    registry.add(
        "neuron",
        "core.izhikevich",
        "neurorobo.neurons.bidimensional_config:IzhikevichConfig",
        "Izhikevich's simple model, with the published regimes by name",
    )
    registry.add(
        "neuron",
        "core.adex",
        "neurorobo.neurons.bidimensional_config:AdExConfig",
        "adaptive exponential integrate-and-fire, in mV and pA",
    )
    registry.add(
        "neuron",
        "core.snntorch_neuron",
        "neurorobo.neurons.snntorch_neuron_config:SnnTorchNeuronConfig",
        "a neuron of snnTorch: Leaky, Lapicque, Synaptic or Alpha",
    )
    registry.add(
        "code",
        "core.population_uniform",
        "neurorobo.codes.config:PopulationUniformConfig",
        "spikes spread evenly over neurons and steps",
    )
    registry.add(
        "code",
        "core.population_nested",
        "neurorobo.codes.config:PopulationNestedConfig",
        "spikes that a larger value only adds to",
    )
    registry.add("code", "core.poisson", "neurorobo.codes.config:PoissonConfig", "independent random spikes")
    registry.add(
        "code",
        "core.time_to_first_spike",
        "neurorobo.codes.config:TimeToFirstSpikeConfig",
        "one spike of each neuron, the earlier the larger the value",
    )
    registry.add(
        "code",
        "core.gaussian_receptive_fields",
        "neurorobo.codes.config:GaussianReceptiveFieldsConfig",
        "each neuron answers to its own part of the range",
    )
    registry.add(
        "code",
        "core.population_signed",
        "neurorobo.codes.population_signed:PopulationSignedConfig",
        "ON spikes above zero, OFF spikes below, silence at zero",
    )
    registry.add(
        "code",
        "core.rank_order",
        "neurorobo.codes.rank_order:RankOrderConfig",
        "one spike of each neuron, the value in their order",
    )
    registry.add(
        "rule",
        "core.supervise",
        "neurorobo.learning.phase:SupervisePhase",
        "learns from a teacher by surrogate gradients",
    )
    registry.add(
        "rule",
        "core.ppo",
        "neurorobo.learning.ppo_config:PpoPhase",
        "learns from the task's reward in the closed loop",
    )
    registry.add(
        "rule", "core.pair_stdp", "neurorobo.plasticity.stdp:PairStdp", "STDP of pairs; with a modulator, by reward"
    )
    registry.add(
        "rule",
        "core.triplet_stdp",
        "neurorobo.plasticity.stdp:TripletStdp",
        "STDP of triplets, which depends on the frequency",
    )
    registry.add(
        "rule",
        "core.eprop",
        "neurorobo.plasticity.eprop:EProp",
        "gradients on line, by a learning signal and eligibility propagation",
    )
    registry.add(
        "rule",
        "core.climbing_fibres",
        "neurorobo.plasticity.climbing_fibre:ClimbingFibre",
        "depression taught by climbing fibres, potentiation without them",
    )
    registry.add(
        "rule",
        "core.synaptic_scaling",
        "neurorobo.plasticity.homeostasis:SynapticScaling",
        "homeostasis: scales synapses until their targets fire at a rate",
    )
    registry.add(
        "recorder",
        "core.trajectory",
        "neurorobo.experiment.trajectory:TrajectoryRecorder",
        "every number of every tick, as Parquet",
    )
    registry.add(
        "recorder",
        "core.rerun",
        "neurorobo.views.recording:RerunRecorder",
        "scene, time series and spike rasters, for the rerun viewer",
    )
