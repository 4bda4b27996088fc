"""Regions that learn while they run."""

from typing import ClassVar

from neurorobo.regions.region import Region


class Plastic(Region):
    """A region whose synapses change as it runs.

    The changes are part of its state, of every member of a batch its own; the parameters stay as they were trained.
    ``learned`` names those parts of the state that outlive an episode where episodes follow one another. It carries
    its state always: nothing would be learned otherwise; and its configuration says that it ``accumulates``, so that a
    graph in which no step keeps that state is refused.
    """

    learned: ClassVar[tuple[str, ...]]
