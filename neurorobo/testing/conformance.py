"""Whether a region keeps its contract."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NoReturn

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.errors import NeuroroboError
from neurorobo.plugins.imports import import_target
from neurorobo.regions import Port, RegionConfig
from neurorobo.regions.region import Probe, Region, State, constrain
from neurorobo.regions.weights import GRID_BITS, load_weights, save_weights, to_grid
from neurorobo.synapses import Projection
from neurorobo.units import UnitError, same_unit

ONE_SECOND = Clock({"control": 1_000_000_000}, 1_000_000, 50)
"""A control period of one second and windows of 50 ms."""

HEAVY = ("torch", "gymnasium", "rerun", "snntorch")
WORDS_OF_A_STEP = ("use", "state", "every")


class ConformanceError(AssertionError):
    """A region breaks its contract; the text names the region, what is wrong, and what to do about it."""


def check_region(config: RegionConfig, clock: Clock = ONE_SECOND, *, batch: int = 3) -> None:
    """Build the region of ``config`` and raise a :class:`ConformanceError` at the first breach of the contract.

    Checked are the ports; that equal seeds give equal weights; that every output has its shape, type and range; that
    ``step`` changes nothing that it was given and keeps nothing to itself; that the ``batch`` members of a batch do not
    influence one another; that a probe hears the spikes and changes nothing; that weights can be saved and loaded; that
    the signs of synapses hold. Inputs are drawn over the range of their code; numbers, which have none, near their
    initial value. Regions without spikes or parameters are checked alike. Errors that the region itself raises pass
    through.
    """
    contract = _Contract(config, clock, batch)
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        contract.check_config()
        contract.check_ports()
        contract.check_building()
        contract.check_state()
        contract.check_outputs()
        contract.check_purity()
        contract.check_probe()
        contract.check_members()
        contract.check_weights()
        contract.check_signs()


@dataclass(frozen=True)
class _Contract:
    """The checks of one region."""

    config: RegionConfig
    clock: Clock
    batch: int

    def check_config(self) -> None:
        """The configuration is light, and its signature can be hashed."""
        module = next(base for base in type(self.config).__mro__ if "implementation" in vars(base)).__module__
        # A plugin may be one file; only where the network has a module of its own is the other one meant to be light.
        if module != self.config.implementation.partition(":")[0] and (heavy := _heavy_imports(module)):
            self.fail(
                f"importing its configuration, `{module}`, imports {heavy} too, which slows down every command; "
                "import it only in the module of the network"
            )
        try:
            text = json.dumps(self.config.signature(self.clock), allow_nan=False, sort_keys=True)
        except (TypeError, ValueError) as error:
            self.fail(f"its `signature` is not JSON ({error}); return numbers, strings, lists and mappings")
        other = self.config.model_copy(update={"weights": "other.safetensors"})
        if json.dumps(other.signature(self.clock), sort_keys=True) != text:
            self.fail("its `signature` changes with `weights`; leave out what weights do not depend on")

    def check_ports(self) -> None:
        """The ports can be wired."""
        if not self.config.outputs(self.clock):
            self.fail("it has no output; a region without one cannot be wired")
        for kind, ports in self.ports().items():
            if ports != self.ports()[kind]:
                self.fail(
                    f"its {kind} ports differ from call to call; let them depend on configuration and clock alone"
                )
            for name, port in ports.items():
                self.check_port(f"the {kind} port `{name}`", name, port)
        for name in WORDS_OF_A_STEP:
            if name in self.config.inputs(self.clock):
                self.fail(
                    f"the input port `{name}` cannot be wired, as the word has its meaning in every step; rename it"
                )

    def check_port(self, place: str, name: str, port: Port) -> None:
        """One port makes sense in itself."""
        if not name.isidentifier():
            self.fail(f"{place} cannot be referred to; use letters, digits and _")
        if port.width < 1:
            self.fail(f"{place} has a width of {port.width}; a quantity has at least one component")
        try:
            same_unit(port.unit, port.unit)
        except UnitError as error:
            self.fail(f"{place}: {error}; use a unit such as `mN` or `um/s`, or `1`")
        if port.code is not None and port.initial is not None:
            outside = [value for value in port.initial if not port.code.lo <= value <= port.code.hi]
            if outside:
                self.fail(f"{place} starts at {outside[0]}, out of its code's range {port.code.lo}..{port.code.hi}")

    def check_building(self) -> None:
        """Equal seeds give equal weights, and the ports are those of the configuration."""
        weights = []
        for elsewhere in (1, 2):
            torch.manual_seed(elsewhere)
            weights.append(self.build(0).state_dict())
        for name, weight in weights[0].items():
            if not torch.equal(weight, weights[1][name]):
                self.fail(
                    f"`{name}` differs when it is built again with the same seed; draw from the `generator` given"
                )
            if weight.is_floating_point() and not weight.isfinite().all():
                self.fail(f"the fresh weights `{name}` are not all finite")

    def check_state(self) -> None:
        """The state at rest is what the graph can keep, for any batch."""
        region = self.build(0)
        for batch in (1, self.batch):
            for name, tensor in region.init_state(batch).items():
                if not isinstance(tensor, Tensor) or "/" in name:
                    self.fail(f"the state `{name}` must be a tensor, under a name without `/`")
                if tensor.dim() == 0 or len(tensor) != batch:
                    shape = tuple(tensor.shape)
                    self.fail(
                        f"the state `{name}` of a batch of {batch} is {shape}; its first dimension must be the batch"
                    )

    def check_outputs(self) -> None:
        """What a step returns is what the ports declare, also from a state that it returned itself."""
        region = self.build(0)
        state = region.init_state(self.batch)
        for window in range(2):
            outputs, after = self.step(region, self.inputs(window), state)
            ports = self.config.outputs(self.clock)
            if outputs.keys() != ports.keys():
                self.fail(f"`step` returned the outputs {sorted(outputs)}, but its ports are {sorted(ports)}")
            for name, port in ports.items():
                self.check_output(f"the output `{name}`", outputs[name], port)
            shapes = {name: (tuple(tensor.shape), tensor.dtype) for name, tensor in after.items()}
            wanted = {name: (tuple(tensor.shape), tensor.dtype) for name, tensor in state.items()}
            if shapes != wanted:
                self.fail(f"`step` returned a state of {shapes}, but was given one of {wanted}; keep names and shapes")
            state = after

    def check_output(self, place: str, value: Tensor, port: Port) -> None:
        """One output has the shape, the type and the values of its port."""
        wanted = [self.batch, port.channels] if port.code is None else [self.clock.window, self.batch, port.channels]
        meaning = "batch, width" if port.code is None else "steps, batch, width * neurons"
        if [*value.shape] != wanted:
            self.fail(f"{place} is {[*value.shape]}, wanted {wanted}: {meaning}")
        if value.dtype != torch.float32:
            self.fail(f"{place} is {value.dtype}, wanted torch.float32")
        if not value.isfinite().all():
            self.fail(f"{place} is not finite everywhere, for inputs within their ranges")
        if port.code is not None and not _are_spikes(value):
            self.fail(f"{place} holds other values than 0 and 1, but its port carries spikes")

    def check_purity(self) -> None:
        """A step changes nothing it is given, keeps nothing, and gives the same again."""
        region = self.build(0)
        inputs, state = self.inputs(0), region.init_state(self.batch)
        given, remembered = _Snapshot(inputs), _Snapshot(state)
        attributes = _Snapshot(_attributes(region))
        torch.manual_seed(1)
        first = self.step(region, inputs, state)
        if changed := given.changed(inputs):
            self.fail(f"`step` changed its input `{changed}`; work on a copy")
        if changed := remembered.changed(state):
            self.fail(f"`step` changed the state `{changed}` that it was given; return a new one")
        if changed := attributes.changed(_attributes(region)):
            self.fail(f"`step` changed the attribute `{changed}`; what a region remembers belongs in its state")
        torch.manual_seed(2)
        if name := _first_difference(first, self.step(region, inputs, state)):
            self.fail(f"two equal calls of `step` differ in {name}; let it depend on inputs, state and weights alone")

    def check_probe(self) -> None:
        """A probe hears the spikes and changes nothing."""
        region = self.build(0)
        inputs, state = self.inputs(0), region.init_state(self.batch)
        heard: dict[str, Tensor] = {}

        def listen(layer: str, spikes: Tensor) -> None:
            heard[layer] = spikes

        without = self.step(region, inputs, state)
        if name := _first_difference(without, self.step(region, inputs, state, listen)):
            self.fail(f"`step` with a probe differs from the one without in {name}; a probe may only listen")
        for layer, spikes in heard.items():
            if spikes.dim() != 3 or spikes.shape[:2] != (self.clock.window, self.batch) or not _are_spikes(spikes):
                shape = tuple(spikes.shape)
                self.fail(f"the probe was given {shape} of the layer `{layer}`, wanted spikes (steps, batch, neurons)")
        if not heard and any(port.code is not None for port in self.config.outputs(self.clock).values()):
            self.fail("its outputs are spikes, but the probe heard none; call it with the spikes of every layer")

    def check_members(self) -> None:
        """Each member of a batch does what it does alone; on the grid of shipped weights its spikes are the same."""
        region = self.build(0)
        region.load_state_dict({n: to_grid(w) if w.is_floating_point() else w for n, w in region.state_dict().items()})
        windows = [self.inputs(seed) for seed in range(3)]
        together = self.run(region, windows, self.batch)
        for i in range(self.batch):
            alone = self.run(region, [self.member(inputs, i) for inputs in windows], 1)
            for window, (outputs, one) in enumerate(zip(together, alone, strict=True)):
                for name, value in self.member(outputs, i, "output").items():
                    spiking = self.config.outputs(self.clock)[name].code is not None
                    if not (torch.equal(value, one[name]) if spiking else _close(value, one[name])):
                        self.fail(
                            f"the output `{name}` of member {i} of a batch of {self.batch} differs from the same run "
                            f"alone, in window {window}; let nothing mix the batch"
                        )

    def check_weights(self) -> None:
        """Weights survive the disk, as floats and in fixed point, and are all there is to a trained region."""
        trained = self.build(0)
        inputs = self.inputs(0)
        for bits in (None, GRID_BITS):
            fresh = self.build(1)
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder, "region.safetensors")
                try:
                    save_weights(trained, path, {}, bits=bits)
                    load_weights(fresh, path)
                except NeuroroboError as error:
                    self.fail(f"its weights cannot be saved and loaded again: {error}")
            for name, weight in trained.state_dict().items():
                expected = to_grid(weight) if bits is not None and weight.is_floating_point() else weight
                if not torch.equal(fresh.state_dict()[name], expected):
                    self.fail(f"`{name}` changed on its way through a weights file")
            if bits is None:
                state = trained.init_state(self.batch)
                results = self.step(trained, inputs, state), self.step(fresh, inputs, state)
                if difference := _first_difference(*results):
                    self.fail(
                        f"with the same weights loaded, {difference} differs; register everything that is drawn at "
                        "random as a parameter, a buffer or a submodule"
                    )

    def check_signs(self) -> None:
        """Synapses keep to Dale's law from the start, and after each step of training."""
        region = self.build(0)
        generator = torch.Generator().manual_seed(0)
        signed = {n: m for n, m in region.named_modules() if isinstance(m, Projection) and m.sign is not None}
        for when in ("when it is built", "after `constrain`"):
            for name, projection in signed.items():
                weight = projection.matrix()
                if ((weight < 0) if projection.sign == "excitatory" else (weight > 0)).any():
                    self.fail(f"the {projection.sign} synapses `{name}` hold weights of the other sign {when}")
                projection.weight.add_(torch.randn(projection.weight.shape, generator=generator))
            constrain(region)

    def fail(self, fault: str) -> NoReturn:
        """Report a breach."""
        raise ConformanceError(f"`{self.config.type}`: {fault}")

    def ports(self) -> dict[str, Mapping[str, Port]]:
        """Ask the configuration for its ports."""
        return {"input": self.config.inputs(self.clock), "output": self.config.outputs(self.clock)}

    def build(self, seed: int) -> Region:
        """Build the region with fresh weights."""
        build: Callable[..., Region] = import_target(self.config.implementation)
        return build(self.config, self.clock, torch.Generator().manual_seed(seed)).eval()

    def inputs(self, seed: int) -> dict[str, Tensor]:
        """Draw a window of inputs, another for every member of the batch."""
        generator = torch.Generator().manual_seed(seed)
        return {name: self.draw(port, generator) for name, port in self.config.inputs(self.clock).items()}

    def draw(self, port: Port, generator: torch.Generator) -> Tensor:
        """Draw values over a code's range, or up to one more than a number's initial value."""
        fraction = torch.rand(self.batch, port.width, generator=generator)
        if port.code is None:
            return torch.tensor(port.initial or (0.0,) * port.width) + fraction
        values = port.code.lo + fraction * (port.code.hi - port.code.lo)
        return port.code.encode(values, self.clock.window, generator)

    def step(
        self, region: Region, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Run one window."""
        result = region.step(inputs, state, probe)
        if not (isinstance(result, tuple) and len(result) == 2 and all(isinstance(part, dict) for part in result)):
            self.fail("`step` must return two dictionaries, (outputs, state)")
        return result

    def run(self, region: Region, windows: list[dict[str, Tensor]], batch: int) -> list[dict[str, Tensor]]:
        """Run windows in a row and return the outputs of each."""
        state, seen = region.init_state(batch), []
        for inputs in windows:
            outputs, state = self.step(region, inputs, state)
            seen.append(outputs)
        return seen

    def member(self, values: Mapping[str, Tensor], i: int, kind: str = "input") -> dict[str, Tensor]:
        """Take one member out of a batch."""
        coded = {name: port.code is not None for name, port in self.ports()[kind].items()}
        return {name: value[:, i : i + 1] if coded[name] else value[i : i + 1] for name, value in values.items()}


class _Snapshot:
    """Named objects as they were: the objects themselves, and the content of tensors and containers."""

    def __init__(self, values: Mapping[str, object]) -> None:
        self.objects = dict(values)
        self.contents = {name: _content(value) for name, value in values.items()}

    def changed(self, now: Mapping[str, object]) -> str | None:
        """Return the first name whose object, or the content of it, is another one now."""
        for name in {**self.objects, **now}:
            if name not in now or name not in self.objects or now[name] is not self.objects[name]:
                return name
            before, after = self.contents[name], _content(now[name])
            if isinstance(before, Tensor) and isinstance(after, Tensor):
                same = before.shape == after.shape and before.equal(after)
            else:
                same = [*map(id, before)] == [*map(id, after)]
            if not same:
                return name
        return None


def _content(value: object) -> Tensor | list[object]:
    if isinstance(value, Tensor):
        return value.clone()
    if isinstance(value, dict):
        return [*value.keys(), *value.values()]
    return [*value] if isinstance(value, list | set) else []


def _attributes(region: Region) -> dict[str, object]:
    """Return every attribute of every module by its dotted name, parameters and buffers too."""
    return {
        f"{prefix}.{name}".lstrip("."): value
        for prefix, module in region.named_modules()
        for name, value in {**vars(module), **module._parameters, **module._buffers}.items()
    }


def _first_difference(one: tuple[Mapping[str, Tensor], State], other: tuple[Mapping[str, Tensor], State]) -> str | None:
    """Name the first output or state that differs between two results of a step."""
    for kind, before, after in zip(("output", "state"), one, other, strict=True):
        if before.keys() != after.keys():
            return f"the names of the {kind}s"
        for name, value in before.items():
            if not torch.equal(value, after[name]):
                return f"the {kind} `{name}`"
    return None


def _are_spikes(tensor: Tensor) -> bool:
    return bool(((tensor == 0) | (tensor == 1)).all())


def _close(one: Tensor, other: Tensor) -> bool:
    """Numbers need not agree to the last bit: vectorised functions round differently at the end of a vector."""
    return bool(((one - other).abs() <= 1e-5 * one.abs().max()).all())


@cache
def _heavy_imports(module: str) -> str:
    """Import a module in an interpreter of its own and return which heavy packages came along."""
    program = f"import sys, {module}; print(*[name for name in {HEAVY} if name in sys.modules])"
    paths = os.pathsep.join(path or os.curdir for path in sys.path)
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
    )
    return ", ".join(done.stdout.split())
