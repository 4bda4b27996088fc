"""Weights files without torch: where the shipped ones are, and whether a file is for a configuration."""

import hashlib
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

from safetensors import SafetensorError, safe_open

from neurorobo.clock import Clock
from neurorobo.errors import NeuroroboError
from neurorobo.regions.config import RegionConfig

FORMAT = "1"


def signature_hash(config: RegionConfig, clock: Clock) -> str:
    """Return 12 hexadecimal digits of all that trained weights depend on."""
    text = json.dumps(config.signature(clock), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def identity(config: RegionConfig, clock: Clock) -> dict[str, str]:
    """Return the metadata by which a weights file is known again: format, configuration and its hash."""
    configuration = json.dumps(config.signature(clock), sort_keys=True)
    return {"format": FORMAT, "configuration": configuration, "signature": signature_hash(config, clock)}


def check_weights_file(path: Path, config: RegionConfig, clock: Clock) -> dict[str, str]:
    """Return the metadata of a weights file that was trained for this configuration.

    Raises :class:`NeuroroboError` if there is no such file, it cannot be read, was written by something else, or is for
    another configuration.
    """
    metadata = _metadata(path)
    if metadata.get("format") != FORMAT:
        raise NeuroroboError(f"{path} was not written by neurorobo; give a file written by `neurorobo train`")
    wanted = identity(config, clock)
    if metadata.get("signature") != wanted["signature"]:
        raise NeuroroboError(
            f"trained for {_difference(metadata, wanted)}: {path}; use the configuration it was trained for, or train "
            "this one"
        )
    return metadata


def pretrained_path(config: RegionConfig, clock: Clock) -> Path:
    """Return the shipped weights file for a configuration, or raise with the list of those there are."""
    package = config.pretrained_package
    if package is None:
        raise NeuroroboError(f"`{config.type}` ships no weights; leave `weights` out, or name a file")
    folder = Path(str(resources.files(package)))
    stem = str(config.signature(clock)["type"]).rpartition(".")[2]
    path = folder / f"{stem}-{signature_hash(config, clock)}.safetensors"
    if path.exists():
        return path
    there = sorted(folder.glob(f"{stem}-*.safetensors"))
    cards = [f"{file.name} ({_metadata(file).get('for', 'no note')})" for file in there]
    raise NeuroroboError(
        f"no shipped weights fit this `{config.type}` ({path.name} is wanted); "
        f"there are: {', '.join(cards) or 'none'}; use one of their configurations, or train this one"
    )


def _metadata(path: Path) -> dict[str, str]:
    try:
        path.open("rb").close()  # safe_open takes whatever it cannot open for absent
        with safe_open(path, framework="numpy") as file:
            return dict(file.metadata() or {})
    except FileNotFoundError:
        raise NeuroroboError(
            f"there is no weights file {path}; train the region, or say `weights: pretrained`"
        ) from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise NeuroroboError(f"{path} cannot be read ({reason}); make it readable, or give another file") from None
    except (SafetensorError, ValueError) as error:
        raise NeuroroboError(f"{path} is not a whole safetensors file ({error}); copy or train it again") from None


def _difference(found: Mapping[str, str], wanted: Mapping[str, str]) -> str:
    """Say in what two configurations differ, if the file holds its own and not only the hash of it."""
    if "configuration" not in found:
        return f"another configuration ({found.get('signature')}, wanted {wanted['signature']})"
    theirs, ours = (json.loads(each["configuration"]) for each in (found, wanted))
    different = [key for key in ours | theirs if ours.get(key) != theirs.get(key)]
    if "type" in different:  # the rest is another matter then
        different = ["type"]
    settings = (", ".join(f"{key}: {json.dumps(each.get(key))}" for key in different) for each in (theirs, ours))
    return ", not ".join(f"`{text}`" for text in settings)
