"""Weights on disk: safetensors files, in fixed point when they are shipped.

A shipped weight is an integer times a power of two. Sums of such weights over spikes are exact in float32, so that a
region gives the same spikes whatever the batch, the number of threads or the order of summation.
"""

import hashlib
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.errors import NeuroroboError
from neurorobo.files import write_whole
from neurorobo.regions.config import RegionConfig
from neurorobo.regions.region import Region

FORMAT = "1"
GRID_BITS = 10
"""Shipped weights are multiples of 2**-10, unless a tensor is given a grid of its own."""


def signature_hash(config: RegionConfig, clock: Clock) -> str:
    """Return 12 hexadecimal digits of all that trained weights depend on."""
    text = json.dumps(config.signature(clock), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def to_grid(tensor: Tensor, bits: int = GRID_BITS) -> Tensor:
    """Round to multiples of ``2**-bits``."""
    return torch.round(tensor * 2.0**bits) / 2.0**bits


def save_weights(
    region: Region, path: Path, notes: Mapping[str, str], *, bits: Mapping[str, int] | int | None = None
) -> None:
    """Write the weights of a region, replacing the file at once or not at all, and the folders that it is in.

    ``notes`` go into the file's metadata. ``bits`` asks for fixed point with that many fractional bits (one number,
    or one per tensor name); without it floats are stored as they are. Raises :class:`NeuroroboError` if a weight does
    not fit 16 bits, or the file cannot be written.
    """
    tensors: dict[str, Tensor] = {}
    grids: dict[str, int] = {}
    for name, tensor in region.state_dict().items():
        if tensor.is_floating_point() and bits is not None:
            grids[name] = bits if isinstance(bits, int) else bits.get(name, GRID_BITS)
            tensor = _smallest_integers(name, (tensor.double() * 2 ** grids[name]).round())
        elif not tensor.is_floating_point():
            tensor = _smallest_integers(name, tensor)
        tensors[name] = tensor.contiguous()
    metadata = {
        **notes,
        "format": FORMAT,
        "signature": signature_hash(region.config, region.clock),
        "fractional_bits": json.dumps(grids, sort_keys=True),
    }
    write_whole(path, save(tensors, metadata))


def load_weights(region: Region, path: Path) -> dict[str, str]:
    """Fill a region with the weights of a file and return the file's metadata.

    Raises :class:`NeuroroboError` if the file cannot be read, was written by something else, or does not fit the
    region.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = dict(file.metadata() or {})
            stored = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
    except FileNotFoundError:
        raise NeuroroboError(
            f"there is no weights file {path}; train the region, or say `weights: pretrained`"
        ) from None
    except (SafetensorError, OSError, ValueError) as error:
        raise NeuroroboError(f"{path} is not a whole safetensors file ({error}); copy or train it again") from None
    if metadata.get("format") != FORMAT:
        raise NeuroroboError(f"{path} was not written by neurorobo; give a file written by `neurorobo train`")
    wanted = region.state_dict()
    if faults := _mismatches(wanted, stored):
        raise NeuroroboError(
            f"{path} does not fit this region: {'; '.join(faults)}; train the region as it is configured now"
        )
    signature = signature_hash(region.config, region.clock)
    if metadata.get("signature") != signature:
        raise NeuroroboError(
            f"{path} was trained for another configuration ({metadata.get('signature')}, wanted {signature}): sizes, "
            "ranges, window or period differ; use the configuration it was trained for, or train this one"
        )
    grids = json.loads(metadata.get("fractional_bits", "{}"))
    values = {
        name: tensor.to(wanted[name].dtype) / 2 ** grids[name] if name in grids else tensor
        for name, tensor in stored.items()
    }
    if broken := [
        name for name, tensor in values.items() if tensor.is_floating_point() and not tensor.isfinite().all()
    ]:
        raise NeuroroboError(
            f"{path} holds weights that are not numbers, in {', '.join(broken)}; train the region again"
        )
    region.load_state_dict({name: tensor.to(wanted[name].dtype) for name, tensor in values.items()})
    return metadata


def pretrained_path(config: RegionConfig, clock: Clock) -> Path:
    """Return the shipped weights file for a configuration, or raise with the list of those there are."""
    package = config.pretrained_package
    if package is None:
        raise NeuroroboError(f"`{config.type}` ships no weights; leave `weights` out, or name a file")
    folder = Path(str(resources.files(package)))
    stem = config.type.rpartition(".")[2]
    path = folder / f"{stem}-{signature_hash(config, clock)}.safetensors"
    if path.exists():
        return path
    there = sorted(folder.glob(f"{stem}-*.safetensors"))
    cards = [f"{file.name} ({_note(file)})" for file in there]
    raise NeuroroboError(
        f"no shipped weights fit this `{config.type}` ({path.name} is wanted); "
        f"there are: {', '.join(cards) or 'none'}; use one of their configurations, or train this one"
    )


def _note(path: Path) -> str:
    with safe_open(path, framework="pt") as file:
        return str((file.metadata() or {}).get("for", "no note"))


def _smallest_integers(name: str, tensor: Tensor) -> Tensor:
    """Store integers in 8, 16 or, for indices only, 32 bits."""
    low, high = (int(tensor.min()), int(tensor.max())) if tensor.numel() else (0, 0)
    for dtype in (torch.int8, torch.int16):
        limits = torch.iinfo(dtype)
        if limits.min <= low and high <= limits.max:
            return tensor.to(dtype)
    if tensor.is_floating_point():
        raise NeuroroboError(
            f"the weights `{name}` reach {max(-low, high)} steps of their grid, more than 16 bits hold; use fewer bits"
        )
    return tensor.to(torch.int32)


def _mismatches(wanted: Mapping[str, Tensor], stored: Mapping[str, Tensor]) -> list[str]:
    faults = [f"`{name}` is missing" for name in wanted if name not in stored]
    faults += [f"`{name}` is unknown" for name in stored if name not in wanted]
    faults += [
        f"`{name}` is {tuple(stored[name].shape)}, wanted {tuple(wanted[name].shape)}"
        for name in wanted
        if name in stored and stored[name].shape != wanted[name].shape
    ]
    return faults
