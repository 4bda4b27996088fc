"""Local learning rules: what changes a synapse is known at its two ends, or is told to all of them."""

from neurorobo.plasticity.rule import Activity, LearningRule, ModulatedRule, Term, TimeConstant

__all__ = ["Activity", "LearningRule", "ModulatedRule", "Term", "TimeConstant"]
