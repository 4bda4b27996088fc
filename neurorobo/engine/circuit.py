"""A circuit: layers that one window passes, one after the other."""

from collections.abc import Collection, Iterable, Mapping, Sequence

import torch
from torch import Tensor
from torch.nn.modules import module as global_hooks

from neurorobo.engine.fired import Probe
from neurorobo.engine.kernels import kernels
from neurorobo.engine.layer import Layer, check_agreement, refuse_transforms
from neurorobo.engine.prepared import Prepared, PreparedCircuit, Stage, prepare

Reads = str | Sequence[str]
"""What a projection reads: an input or a layer before it, or several of them side by side."""


class Circuit:
    """Layers by name, and what each of their projections reads; a whole window runs through them at once.

    For inference the native path runs them in one call, which hands on spikes as bits. Elsewhere they run layer by
    layer, with the same spikes. A circuit holds no parameters: the layers are modules of whoever builds it, such as a
    region, and keep their names there. If one of them is replaced, the circuit is to be built anew.
    """

    def __init__(self, inputs: Iterable[str], layers: Mapping[str, tuple[Layer, Sequence[Reads]]]) -> None:
        """Build it from ``{name: (layer, [what each projection reads])}`` in order.

        A layer that is called as an input is hides it from those behind. Raises a ValueError if something is read that
        is not known by then, or if a layer has more or fewer projections.
        """
        self.inputs = list(inputs)
        self.layers = {name: layer for name, (layer, _) in layers.items()}
        self._prepared = Prepared()
        self._stages: list[Stage] = []
        known = {name: number for number, name in enumerate(self.inputs)}
        for number, (name, (layer, reads)) in enumerate(layers.items(), start=len(self.inputs)):
            if len(reads) != len(layer.projections):
                raise ValueError(f"{name}: {len(layer.projections)} projections were given {len(reads)} readings")
            names = [(read,) if isinstance(read, str) else tuple(read) for read in reads]
            if not all(names):
                raise ValueError(f"{name}: a projection reads nothing")
            for read in sum(names, ()):
                if read not in known:
                    raise ValueError(f"{name} reads {read!r}; known by then: {', '.join(known)}")
            self._stages.append(Stage(layer, [tuple(known[read] for read in group) for group in names]))
            known[name] = number

    @property
    def readings(self) -> dict[str, list[tuple[str, ...]]]:
        """What each projection of each layer reads, as names of inputs and layers side by side."""
        known = [*self.inputs, *self.layers]
        return {
            name: [tuple(known[number] for number in numbers) for numbers in stage.reads]
            for name, stage in zip(self.layers, self._stages, strict=True)
        }

    def __call__(
        self,
        inputs: Mapping[str, Tensor],
        state: Mapping[str, Tensor] | None = None,
        wanted: Collection[str] | None = None,
        probe: Probe | None = None,
    ) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """Run one window: the spikes of each input and the states of some layers -> spikes and the new states.

        Spikes are (steps, batch, neurons), those of the layers that are ``wanted``, or of all. Layers without a state
        start at rest, and tell none. The ``probe`` hears all layers. Raises what :class:`Layer` does, and a ValueError
        if an input is missing or a layer is unknown.
        """
        state = {} if state is None else state
        for name in self.inputs:
            if name not in inputs:
                raise ValueError(f"a circuit of the inputs {', '.join(self.inputs)} was not given {name!r}")
        for name in (*state, *(() if wanted is None else wanted)):
            if name not in self.layers:
                raise ValueError(f"a circuit of the layers {', '.join(self.layers)} has no {name!r}")
        given = [inputs[name] for name in self.inputs]
        if not torch.is_grad_enabled() and not torch.compiler.is_compiling():
            ran = self._run_prepared(given, state, self.layers if wanted is None else wanted, probe)
            if ran is not None:
                return ran
        known, joined = given, dict[tuple[int, ...], Tensor]()
        spikes: dict[str, Tensor] = {}
        after: dict[str, Tensor] = {}
        for name, (layer, reads) in zip(self.layers, self._stages, strict=True):
            for numbers in reads:
                if numbers not in joined:
                    pieces = [known[number] for number in numbers]
                    check_agreement(pieces)
                    joined[numbers] = torch.cat(pieces, dim=-1) if len(pieces) > 1 else pieces[0]
            fired, last = layer([joined[numbers] for numbers in reads], state.get(name))
            known.append(fired)
            if probe is not None:
                probe(name, fired)
            if name in state:
                after[name] = last
            if wanted is None or name in wanted:
                spikes[name] = fired
        return spikes, after

    def _run_prepared(
        self,
        inputs: Sequence[Tensor],
        state: Mapping[str, Tensor],
        wanted: Collection[str],
        probe: Probe | None,
    ) -> tuple[dict[str, Tensor], dict[str, Tensor]] | None:
        """Run a window in one call; None if it has to go layer by layer."""
        native = kernels()
        if native is None or self._is_watched():
            return None
        refuse_transforms()
        states = [state.get(name) for name in self.layers]
        prepared = self._prepared.take()
        if prepared is None or not prepared.fits(native, inputs, states):
            prepared = self._prepare(inputs, states)
            if prepared is None:
                return None
        hear = getattr(probe, "hear", None)
        writes_all = probe is not None and hear is None
        ran = prepared.run(
            inputs,
            states,
            [writes_all or name in wanted for name in self.layers],
            [before is not None for before in states],
        )
        if ran is not None and hear is not None:
            for number, name in enumerate(self.layers):
                hear(name, prepared.fired(number))
        self._prepared.put(prepared)
        if ran is None:
            return None
        spikes, lasts = (
            {name: tensor for name, tensor in zip(self.layers, tensors, strict=True) if tensor is not None}
            for tensors in ran
        )
        if probe is not None and hear is None:
            for name, fired in spikes.items():
                probe(name, fired)
            spikes = {name: fired for name, fired in spikes.items() if name in wanted}
        return spikes, lasts

    def _prepare(self, inputs: Sequence[Tensor], states: Sequence[Tensor | None]) -> PreparedCircuit | None:
        native = kernels()
        windows = {tuple(spikes.shape[:-1]) for spikes in inputs}
        if native is None or len(windows) != 1 or any(spikes.dim() != 3 or not len(spikes) for spikes in inputs):
            return None
        for layer in self.layers.values():
            if type(layer) is not Layer:
                return None
            layer.check_parameters()
        return prepare(native, self._stages, inputs, states)

    def _is_watched(self) -> bool:
        """Return whether someone's hooks are to see each layer run."""
        if global_hooks._global_forward_hooks or global_hooks._global_forward_pre_hooks:
            return True
        return any(layer._forward_hooks or layer._forward_pre_hooks for layer in self.layers.values())
