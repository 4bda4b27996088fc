"""Codes between physical quantities and windows of spikes."""

from neurorobo.codes.coarse_fine import CoarseFine
from neurorobo.codes.code import Code
from neurorobo.codes.config import CodeConfig
from neurorobo.codes.first_spike import TimeToFirstSpike
from neurorobo.codes.rate import CountCode, Poisson, PopulationNested, PopulationUniform
from neurorobo.codes.receptive_fields import GaussianReceptiveFields

__all__ = [
    "CoarseFine",
    "Code",
    "CodeConfig",
    "CountCode",
    "GaussianReceptiveFields",
    "Poisson",
    "PopulationNested",
    "PopulationUniform",
    "TimeToFirstSpike",
]
