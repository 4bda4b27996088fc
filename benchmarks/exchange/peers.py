"""Other libraries that read NIR, each as a function of a graph and input spikes.

Each returns the spikes (steps, batch, neurons) of every LIF or IF node, by its name. The libraries are told the time
step that the graph was written for, and otherwise left as they are.
"""

import contextlib
import io
import logging
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor, nn

from neurorobo.interchange.neurons import STEP_S

Peer = Callable[[Any, Tensor], dict[str, Tensor]]


@torch.no_grad()
def snntorch(graph: Any, inputs: Tensor) -> dict[str, Tensor]:
    """Run the nodes of snnTorch, wired by nirtorch.

    Its own importer gives other spikes where there is recurrence: it puts a graph into the graph.
    """
    import nir
    import nirtorch
    from snntorch.import_nir import _nir_to_snntorch_module

    def convert(node: Any) -> nn.Module:
        with contextlib.redirect_stdout(io.StringIO()):  # it prints what it scales
            module: nn.Module = _nir_to_snntorch_module(node, init_hidden=True)
        return module

    kinds = (nir.Linear, nir.Affine, nir.LIF)
    return _stepped(nirtorch.nir_to_torch(graph, dict.fromkeys(kinds, convert)), graph, inputs)


@torch.no_grad()
def snntorch_importer(graph: Any, inputs: Tensor) -> dict[str, Tensor]:
    """Run in snnTorch by its own importer, for graphs without recurrence."""
    from snntorch.import_nir import import_from_nir

    with contextlib.redirect_stdout(io.StringIO()):
        model = import_from_nir(graph)
    return _stepped(model, graph, inputs)


@torch.no_grad()
def spikingjelly(graph: Any, inputs: Tensor) -> dict[str, Tensor]:
    """Run in SpikingJelly."""
    with _quiet():
        from spikingjelly.activation_based.nir_exchange import import_from_nir

        model = import_from_nir(graph, dt=STEP_S)
    return _stepped(model, graph, inputs)


@torch.no_grad()
def norse(graph: Any, inputs: Tensor) -> dict[str, Tensor]:
    """Run the nodes of Norse, wired by nirtorch.

    Its own importer gives other spikes where a population reads several nodes: some of them arrive a step late.
    """
    import nir
    import nirtorch

    with _quiet():
        from norse.torch.utils.import_nir import _import_norse_module

    def convert(node: Any) -> nn.Module:
        module: nn.Module = _import_norse_module(node, dt=STEP_S)
        return module

    kinds = (nir.Linear, nir.Affine, nir.LIF)
    return _stepped(nirtorch.nir_to_torch(graph, dict.fromkeys(kinds, convert)), graph, inputs)


@torch.no_grad()
def norse_importer(graph: Any, inputs: Tensor) -> dict[str, Tensor]:
    """Run in Norse by its own importer, for graphs in which every population reads one node, and perhaps itself."""
    with _quiet():
        from norse.torch import from_nir

        model = from_nir(graph, dt=STEP_S)
    return _stepped(model, graph, inputs)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep a library's warnings about itself from the screen."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logging.disable(logging.WARNING)
        try:
            yield
        finally:
            logging.disable(logging.NOTSET)


def _stepped(model: nn.Module, graph: Any, inputs: Tensor) -> dict[str, Tensor]:
    """Run a model step by step, and listen to its neurons."""
    heard: dict[str, list[Tensor]] = {}
    modules = dict(model.named_modules())
    for name, node in graph.nodes.items():
        if type(node).__name__ in ("LIF", "IF"):
            trains = heard[name] = []

            def listen(_: nn.Module, __: object, output: Any, trains: list[Tensor] = trains) -> None:
                spikes = output[0] if isinstance(output, tuple) else output
                trains.append(spikes.detach().clone())

            modules[name.replace(".", "_")].register_forward_hook(listen)
    state = None
    for now in inputs:
        _, state = model(now) if state is None else model(now, state)
    return {name: torch.stack(trains) for name, trains in heard.items()}


PEERS: dict[str, Peer] = {
    "snnTorch": snntorch,
    "snnTorch's importer": snntorch_importer,
    "SpikingJelly": spikingjelly,
    "Norse": norse,
    "Norse's importer": norse_importer,
}
