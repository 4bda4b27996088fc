"""Weights on disk: what is written is read, and whatever cannot be read says why, naming the file."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from neurorobo.clock import Clock
from neurorobo.errors import NeuroroboError
from neurorobo.regions.weights import load_weights, save_weights, to_grid
from neurorobo.regions.weights_file import pretrained_path, signature_hash
from tests.regions.toys import CLOCK, MS, Net, NetConfig, net


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "net.safetensors"


def weights(region: Net) -> dict[str, torch.Tensor]:
    return {name: tensor.clone() for name, tensor in region.state_dict().items()}


def assert_equal(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> None:
    assert one.keys() == other.keys()
    for name, tensor in one.items():
        assert tensor.dtype == other[name].dtype, name
        assert torch.equal(tensor, other[name]), name


def test_floats_come_back_bit_for_bit_with_the_notes(path: Path) -> None:
    trained, fresh = net(1), net(2)
    save_weights(trained, path, {"for": "a test"})
    metadata = load_weights(fresh, path)
    assert_equal(weights(fresh), weights(trained))
    assert metadata["for"] == "a test"
    assert metadata["signature"] == signature_hash(trained.config, CLOCK)


def test_the_same_weights_and_notes_are_the_same_bytes(path: Path) -> None:
    notes = {f"note {i}": "µ" * i for i in range(20)}
    save_weights(net(1), path, notes)
    once = path.read_bytes()
    save_weights(net(1), path, dict(reversed(notes.items())))
    assert path.read_bytes() == once
    assert load_weights(net(2), path)["note 3"] == "µµµ"


def test_fixed_point_comes_back_as_the_grid_says_each_tensor_on_its_own(path: Path) -> None:
    trained, fresh = net(1), net(2)
    name = "hidden.recurrent.weight"
    save_weights(trained, path, {}, bits={name: 6})
    load_weights(fresh, path)
    expected = {
        key: to_grid(tensor, 6 if key == name else 10) if tensor.is_floating_point() else tensor
        for key, tensor in weights(trained).items()
    }
    assert_equal(weights(fresh), expected)


def test_weights_on_the_grid_are_stored_exactly_and_small(path: Path) -> None:
    trained = net(1)
    with torch.no_grad():
        for parameter in trained.parameters():
            parameter.copy_(to_grid(parameter, 5).clamp(-2, 2))
    trained.state_dict()["hidden.recurrent.weight"][0, 0] = 100.0
    save_weights(trained, path, {}, bits=5)
    fresh = net(2)
    load_weights(fresh, path)
    assert_equal(weights(fresh), weights(trained))
    with safe_open(path, framework="pt") as file:
        types = {name: file.get_tensor(name).dtype for name in weights(trained)}
    assert types.pop("hidden.recurrent.weight") == torch.int16
    assert set(types.values()) == {torch.int8}  # also the source indices


def test_weights_beyond_16_bits_are_refused_and_the_old_file_stays(path: Path) -> None:
    region = net(1)
    save_weights(region, path, {"for": "the old one"})
    with torch.no_grad():
        region.hidden.recurrent.weight[0, 0] = 40.0  # type: ignore[union-attr]
    with pytest.raises(NeuroroboError, match=r"`hidden.recurrent.weight` reach 40960 steps .* use fewer bits"):
        save_weights(region, path, {}, bits=10)
    assert load_weights(net(), path)["for"] == "the old one"
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def foreign(path: Path) -> None:
    save_file(weights(net()), path, {"format": "pt"})


def without_metadata(path: Path) -> None:
    save_file(weights(net()), path)


def truncated(path: Path) -> None:
    save_weights(net(), path, {})
    path.write_bytes(path.read_bytes()[:-10])


def text(path: Path) -> None:
    path.write_text("regions: {}\n")


def empty(path: Path) -> None:
    path.write_bytes(b"")


def a_folder(path: Path) -> None:
    path.mkdir()


def absent(path: Path) -> None:
    pass


def a_link_to_itself(path: Path) -> None:
    path.symlink_to(path)


def of_another_shape(path: Path) -> None:
    save_weights(net(config=NetConfig(hidden=11)), path, {})


def of_another_region(path: Path) -> None:
    save_weights(net(config=OtherConfig(hidden=11)), path, {})


def with_the_hash_of_another(path: Path) -> None:
    of_another_shape(path)
    with safe_open(path, framework="pt") as file:
        tensors, metadata = {name: file.get_tensor(name) for name in file.keys()}, file.metadata()  # noqa: SIM118
    del metadata["configuration"]
    save_file(tensors, path, metadata)


def not_numbers(path: Path) -> None:
    region = net()
    with torch.no_grad():
        region.hidden.recurrent.weight[3, 3] = float("nan")  # type: ignore[union-attr]
    save_weights(region, path, {})


def with_a_tensor_less(path: Path) -> None:
    rewrite(path, lambda tensors: tensors.pop("hidden.threshold"))


def with_a_tensor_more(path: Path) -> None:
    rewrite(path, lambda tensors: tensors.update(bias=torch.zeros(3)))


def with_other_tensors(path: Path) -> None:
    rewrite(path, lambda tensors: tensors.update(bias=tensors.pop("hidden.threshold")))


def rewrite(path: Path, change: Callable[[dict[str, torch.Tensor]], object]) -> None:
    save_weights(net(), path, {})
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    tensors = weights(net())
    change(tensors)
    save_file(tensors, path, metadata)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (absent, "there is no weights file"),
        (a_folder, "cannot be read (Is a directory); make it readable"),
        (a_link_to_itself, "cannot be read (Too many levels of symbolic links); make it readable"),
        (text, "is not a whole safetensors file"),
        (empty, "is not a whole safetensors file"),
        (truncated, "is not a whole safetensors file"),
        (foreign, "was not written by neurorobo"),
        (without_metadata, "was not written by neurorobo"),
        (of_another_shape, "trained for `hidden: 11`, not `hidden: 10`: "),
        (of_another_region, 'trained for `type: "toy.other"`, not `type: "toy.net"`: '),
        (with_the_hash_of_another, "trained for another configuration ("),
        (with_a_tensor_less, "`hidden.threshold` is missing: "),
        (with_a_tensor_more, "`bias` is unknown: "),
        (with_other_tensors, "`hidden.threshold` is missing and 1 more: "),
        (not_numbers, "holds weights that are not numbers, in hidden.recurrent.weight"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_the_fault_and_the_region_stays_as_it_was(
    path: Path, spoil: Callable[[Path], None], words: str
) -> None:
    spoil(path)
    region = net(3)
    before = weights(region)
    with pytest.raises(NeuroroboError) as caught:
        load_weights(region, path)
    message = str(caught.value)
    assert str(path) in message
    assert words in message
    assert "\n" not in message
    assert_equal(weights(region), before)


def test_the_signature_tells_apart_what_trained_weights_depend_on() -> None:
    plain = NetConfig()
    same = [NetConfig(weights="elsewhere.safetensors"), NetConfig(carry="always")]
    assert {signature_hash(config, CLOCK) for config in same} == {signature_hash(plain, CLOCK)}
    longer = Clock({"control": 1000 * MS}, MS, 40)
    assert (
        len({signature_hash(plain, CLOCK), signature_hash(NetConfig(hidden=9), CLOCK), signature_hash(plain, longer)})
        == 3
    )


def test_a_region_that_ships_no_weights_says_so() -> None:
    with pytest.raises(NeuroroboError, match=r"`toy\.net` ships no weights"):
        pretrained_path(NetConfig(), CLOCK)


class OtherConfig(NetConfig):
    """Of another type."""

    type: Literal["toy.other"] = "toy.other"  # type: ignore[assignment]


class ShippedConfig(NetConfig):
    """Its weights lie in a package."""

    pretrained_package = "shipped_nets"


def test_shipped_weights_are_found_by_their_signature_or_those_there_are_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "shipped_nets"
    package.mkdir()
    (package / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    region = net(1)
    shipped = package / f"net-{signature_hash(region.config, CLOCK)}.safetensors"
    save_weights(region, shipped, {"for": "ten hidden neurons"})
    assert pretrained_path(ShippedConfig(), CLOCK) == shipped
    with pytest.raises(NeuroroboError) as caught:
        pretrained_path(ShippedConfig(hidden=9), CLOCK)
    assert f"there are: {shipped.name} (ten hidden neurons)" in str(caught.value)


def test_the_metadata_are_readable_without_the_tensors(path: Path) -> None:
    save_weights(net(), path, {"for": "a test"}, bits=10)
    with safe_open(path, framework="pt") as file:
        grids = json.loads(file.metadata()["fractional_bits"])
    assert set(grids) == {name for name, tensor in weights(net()).items() if tensor.is_floating_point()}
    assert set(grids.values()) == {10}
