"""Weights on disk: safetensors files, in fixed point when they are shipped.

A shipped weight is an integer times a power of two. Sums of such weights over spikes are exact in float32, so that a
region gives the same spikes whatever the batch, the number of threads or the order of summation.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor

from neurorobo.errors import NeuroroboError
from neurorobo.files import write_whole
from neurorobo.regions.region import Region
from neurorobo.regions.weights_file import check_weights_file, identity

GRID_BITS = 10
"""Shipped weights are multiples of 2**-10, unless a tensor is given a grid of its own."""


def to_grid(tensor: Tensor, bits: int = GRID_BITS) -> Tensor:
    """Round to multiples of ``2**-bits``."""
    return torch.round(tensor * 2.0**bits) / 2.0**bits


def save_weights(
    region: Region, path: Path, notes: Mapping[str, str], *, bits: Mapping[str, int] | int | None = None
) -> None:
    """Write the weights of a region, replacing the file at once or not at all, and the folders that it is in.

    ``notes`` go into the file's metadata, sorted, so that the same weights and notes are the same bytes. ``bits`` asks
    for fixed point with that many fractional bits (one number, or one per tensor name); without it floats are stored as
    they are. Raises :class:`NeuroroboError` if a weight does not fit 16 bits, or the file cannot be written.
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
        **identity(region.config, region.clock),
        "fractional_bits": json.dumps(grids, sort_keys=True),
    }
    write_whole(path, _with_sorted_metadata(save(tensors, metadata)))


def load_weights(region: Region, path: Path) -> dict[str, str]:
    """Fill a region with the weights of a file and return the file's metadata.

    Raises :class:`NeuroroboError` as :func:`check_weights_file` does, and if the tensors do not fit the region or are
    not finite.
    """
    metadata = check_weights_file(path, region.config, region.clock)
    with safe_open(path, framework="pt") as file:
        stored = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
    wanted = region.state_dict()
    if faults := _mismatches(wanted, stored):
        more = f" and {len(faults) - 1} more" if len(faults) > 1 else ""
        raise NeuroroboError(f"{faults[0]}{more}: {path} was trained by another version of the region; train it again")
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


def _with_sorted_metadata(content: bytes) -> bytes:
    """Return a safetensors file with its metadata sorted, which the library writes in an order that it draws anew.

    The file is the length of its header (8 bytes, little-endian), the header, JSON padded to a multiple of 8, and data.
    """
    end = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:end])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + content[end:]


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
