"""The conformance kit passes what keeps the contract, and catches what breaks it, by name."""

from pathlib import Path

import pytest
import torch

from neurorobo.clock import Clock
from neurorobo.plugins import Registry
from neurorobo.regions import RegionConfig
from neurorobo.regions.sum_config import SumConfig
from neurorobo.testing import ConformanceError, check_region
from tests.graph.toys import AddConfig, CountConfig, SpikingRelayConfig
from tests.regions.toys import CLOCK, Net, NetConfig
from tests.testing import broken

GOOD = [AddConfig(), CountConfig(carry="always"), SpikingRelayConfig(), NetConfig(), SumConfig(unit="mN", width=3)]


@pytest.mark.parametrize("config", GOOD, ids=lambda config: config.type)
def test_regions_that_keep_the_contract_pass(config: RegionConfig) -> None:
    check_region(config)
    check_region(config, CLOCK, batch=5)


def bundled() -> Registry:
    """The core and the bundle, whatever else is installed."""
    from precision_interaction import plugin

    registry = Registry()
    registry.add_plugin("precision", plugin)
    return registry


@pytest.mark.parametrize("name", [name for name in bundled().names("region") if name.startswith("precision.")])
def test_bundled_regions_pass(name: str) -> None:
    second = 1_000_000_000
    config = bundled().get("region", name).model_validate({"type": name})
    check_region(config, Clock({"control": second, "radial": second}, 1_000_000, 50))


@pytest.mark.parametrize("region", broken.REGIONS, ids=lambda region: region.__name__)
def test_a_broken_region_is_caught_by_name(region: type[Net]) -> None:
    with pytest.raises(ConformanceError) as caught:
        check_region(broken.config_of(region))
    assert str(caught.value).startswith("`toy.net`: ")
    assert broken.REGIONS[region] in str(caught.value)


@pytest.mark.parametrize("config", broken.CONFIGS, ids=lambda config: config.__name__)
def test_a_broken_configuration_is_caught_by_name(config: type[NetConfig]) -> None:
    with pytest.raises(ConformanceError) as caught:
        check_region(config())
    assert broken.CONFIGS[config] in str(caught.value)


def test_a_configuration_that_imports_torch_is_caught_unless_the_network_shares_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = "from tests.regions.toys import Net, NetConfig\nclass Heavy(NetConfig):\n    implementation = '{}:Net'\n"
    (tmp_path / "heavy_configs.py").write_text(source.format("tests.regions.toys"))
    (tmp_path / "one_file.py").write_text(source.format("one_file"))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    from heavy_configs import Heavy  # type: ignore[import-not-found]
    from one_file import Heavy as OneFile  # type: ignore[import-not-found]

    check_region(OneFile())
    with pytest.raises(ConformanceError, match="importing its configuration, `heavy_configs`, imports torch too"):
        check_region(Heavy())


def test_the_check_leaves_the_global_generator_as_it_was() -> None:
    torch.manual_seed(3)
    expected = torch.rand(1)
    torch.manual_seed(3)
    check_region(NetConfig())
    assert torch.equal(torch.rand(1), expected)


def test_a_region_that_needs_a_period_gets_the_clock_it_is_checked_with() -> None:
    class Needy(NetConfig):
        def inputs(self, clock: Clock):  # type: ignore[no-untyped-def]
            assert "radial" in clock.periods_ns
            return super().inputs(clock)

    with pytest.raises(AssertionError):
        check_region(Needy())
    second = 1_000_000_000
    check_region(Needy(), Clock({"control": second, "radial": second // 5}, 1_000_000, 20))
