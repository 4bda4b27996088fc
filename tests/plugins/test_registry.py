import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import dedent

import pytest

from neurorobo.errors import NeuroroboError
from neurorobo.plugins import KINDS, PluginInfo, Registry

Install = Callable[..., None]

GOOD = """
    from neurorobo.plugins import hookimpl

    @hookimpl
    def neurorobo_register(registry):
        registry.add("region", "{prefix}.cortex", "{module}_types:Cortex", "a cortex")
        registry.add("body", "{prefix}.arm", "{module}_types:Arm")
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Return a function that installs a distribution with one plugin, as pip would leave it on the path."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delenv("NEUROROBO_PLUGINS", raising=False)
    modules: list[str] = []

    def install(
        distribution: str, module: str, plugin: str = GOOD, types: str = "class Cortex: pass", prefix: str = ""
    ) -> None:
        prefix = prefix or module
        (tmp_path / f"{module}.py").write_text(dedent(plugin.replace("{prefix}", prefix).replace("{module}", module)))
        (tmp_path / f"{module}_types.py").write_text(dedent(types))
        info = tmp_path / f"{distribution.replace('-', '_')}-0.2.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 0.2\n")
        (info / "entry_points.txt").write_text(f"[neurorobo.plugins]\n{prefix} = {module}\n")
        modules.extend([module, f"{module}_types"])

    yield install
    for name in modules:
        sys.modules.pop(name, None)


def info(registry: Registry, name: str) -> PluginInfo:
    [found] = [plugin for plugin in registry.plugins() if plugin.name == name]
    return found


def message(registry: Registry, kind: str, name: str) -> str:
    with pytest.raises(NeuroroboError) as caught:
        registry.get(kind, name)  # type: ignore[arg-type]
    return str(caught.value)


def test_a_plugin_provides_types_by_name(install: Install) -> None:
    install("acme-nr", "acme")
    registry = Registry.discover()
    assert registry.get("region", "acme.cortex").__name__ == "Cortex"
    assert "acme.cortex" in registry.names("region")
    assert "acme.arm" in registry.names("body")
    found = info(registry, "acme")
    assert (found.distribution, found.version, found.status, found.error) == ("acme-nr", "0.2", "loaded", "")
    assert [entry.name for entry in found.provides] == ["acme.cortex", "acme.arm"]
    assert registry.entry("region", "acme.cortex").summary == "a cortex"


def test_only_the_plugin_that_is_asked_for_is_imported_and_its_types_later_still(install: Install) -> None:
    install("acme-nr", "acme")
    install("other-nr", "other")
    registry = Registry.discover()
    assert not {"acme", "other"} & set(sys.modules)
    registry.entry("region", "acme.cortex")
    assert {"acme", "acme_types", "other"} & set(sys.modules) == {"acme"}
    registry.get("region", "acme.cortex")
    assert {"acme", "acme_types", "other"} & set(sys.modules) == {"acme", "acme_types"}


@pytest.mark.parametrize(
    ("plugin", "error"),
    [
        ("import no_such_module", "failed to import: ModuleNotFoundError: No module named 'no_such_module'"),
        ("x = ", "failed to import: SyntaxError: "),
        ("raise SystemExit(3)", "failed to import: SystemExit: 3"),
        ("1 / 0", "failed to import: ZeroDivisionError: "),
        ("", "failed to register: it implements no hook; decorate `neurorobo_register`"),
        (
            GOOD.replace("neurorobo_register", "neurorobo_registr"),
            "failed to register: PluginValidationError: unknown hook 'neurorobo_registr'",
        ),
        (GOOD.replace("(registry)", "(registr)"), "failed to register: PluginValidationError: "),
        (
            GOOD.replace("{prefix}.arm", "core.arm"),
            "failed to register: `core.arm` is no name for a body of this plugin; call it `acme.",
        ),
        (GOOD.replace("{prefix}.arm", "arm"), "failed to register: `arm` is no name for a body"),
        (
            GOOD.replace('"body"', '"bodi"'),
            "failed to register: unknown kind `bodi` of `acme.arm`; did you mean `body`?",
        ),
        (
            GOOD.replace("_types:Arm", "_types.Arm"),
            "failed to register: `acme_types.Arm`, the target of `acme.arm`, is not of the form",
        ),
        (
            GOOD.replace('"body", "{prefix}.arm"', '"region", "{prefix}.cortex"'),
            "failed to register: the region `acme.cortex` is registered twice",
        ),
    ],
)
def test_a_broken_plugin_is_reported_when_it_is_asked_for_and_harms_no_other(
    install: Install, plugin: str, error: str
) -> None:
    install("acme-nr", "acme", plugin)
    install("other-nr", "other")
    registry = Registry.discover()
    assert registry.get("region", "other.cortex").__name__ == "Cortex"
    assert "other.cortex" in registry.names("region")
    assert message(registry, "region", "acme.cortex").startswith(
        f"`acme.cortex` belongs to the plugin acme-nr 0.2, which {error}"
    )
    broken = info(registry, "acme")
    assert (broken.status, broken.provides) == ("broken", ())
    assert broken.error.startswith(error)


def test_a_type_whose_module_does_not_import_is_named_with_its_plugin(install: Install) -> None:
    install("acme-nr", "acme", types="import no_such_module")
    assert message(Registry.discover(), "region", "acme.cortex") == (
        "`acme.cortex` belongs to the plugin acme-nr 0.2: `acme_types:Cortex` cannot be imported "
        "(ModuleNotFoundError: No module named 'no_such_module'); repair or reinstall the plugin that provides it"
    )


def test_a_type_that_its_module_does_not_have_is_named_with_its_plugin(install: Install) -> None:
    install("acme-nr", "acme")
    assert message(Registry.discover(), "body", "acme.arm") == (
        "`acme.arm` belongs to the plugin acme-nr 0.2: `acme_types:Arm` cannot be imported "
        "(AttributeError: module 'acme_types' has no attribute 'Arm'); repair or reinstall the plugin that provides it"
    )


def test_two_plugins_of_one_name_are_both_refused(install: Install) -> None:
    install("acme-nr", "acme")
    install("zebra-nr", "zebra", prefix="acme")
    install("other-nr", "other")
    registry = Registry.discover()
    assert "uninstall one of them" in message(registry, "region", "acme.cortex")
    assert "acme-nr 0.2" in message(registry, "region", "acme.cortex")
    assert "zebra-nr 0.2" in message(registry, "region", "acme.cortex")
    assert registry.get("region", "other.cortex")


@pytest.mark.parametrize(
    ("prefix", "error"), [("core", "the name is taken"), ("Ac-Me", "a prefix is of lower case letters")]
)
def test_a_plugin_cannot_take_the_core_s_name_nor_one_that_no_type_could_have(
    install: Install, prefix: str, error: str
) -> None:
    core = Registry().names("region")
    install("acme-nr", "acme", prefix=prefix)
    registry = Registry.discover()
    [refused] = [plugin for plugin in registry.plugins() if plugin.distribution == "acme-nr"]
    assert refused.status == "broken"
    assert error in refused.error
    assert set(core) <= set(registry.names("region"))
    assert "core.cortex" not in registry.names("region")


def test_the_environment_can_restrict_the_plugins(install: Install, monkeypatch: pytest.MonkeyPatch) -> None:
    install("acme-nr", "acme")
    install("other-nr", "other")
    monkeypatch.setenv("NEUROROBO_PLUGINS", "other")
    registry = Registry.discover()
    assert registry.get("region", "other.cortex")
    assert info(registry, "acme").status == "excluded"
    assert message(registry, "region", "acme.cortex") == (
        "`acme.cortex` belongs to the plugin acme-nr 0.2, which NEUROROBO_PLUGINS leaves out"
    )
    assert "acme" not in sys.modules
    monkeypatch.setenv("NEUROROBO_PLUGINS", "")
    assert "other.cortex" not in Registry.discover().names("region")
    monkeypatch.setenv("NEUROROBO_PLUGINS", "othr")
    with pytest.raises(NeuroroboError, match="lists `othr`, which is not installed; did you mean `other`"):
        Registry.discover()


def test_an_unknown_name_gets_its_near_misses(install: Install) -> None:
    install("acme-nr", "acme")
    registry = Registry.discover()
    assert message(registry, "region", "acme.cortx") == "unknown region `acme.cortx`; did you mean `acme.cortex`?"
    assert "did you mean `acme.cortex`" in message(registry, "region", "akme.cortex")
    assert message(registry, "region", "acme.arm").startswith("`acme.arm` is a body, not a region")


def test_the_core_s_names_need_no_prefix() -> None:
    registry = Registry()
    provided = [entry for entry in info(registry, "core").provides]
    for entry in provided:
        assert registry.entry(entry.kind, entry.name.removeprefix("core.")) == entry
    assert provided
    assert {entry.kind for entry in provided} <= set(KINDS)


def test_a_module_can_be_added_without_installing_it(install: Install) -> None:
    install("acme-nr", "acme")
    import acme  # type: ignore[import-not-found]

    registry = Registry()
    registry.add_plugin("acme", acme)
    assert registry.get("region", "acme.cortex").__name__ == "Cortex"
    for name in ("acme", "core", "Not a name"):
        with pytest.raises(NeuroroboError, match="cannot be called"):
            registry.add_plugin(name, acme)


HOOKS = """
    from neurorobo.plugins import hookimpl

    @hookimpl
    def neurorobo_run_started(folder):
        (folder / "{module}").touch()
"""


def test_a_hook_reaches_every_plugin_even_if_one_fails(install: Install, tmp_path: Path) -> None:
    install("acme-nr", "acme", HOOKS.replace("touch()", "mkdir(mode='x')"))
    install("broken-nr", "broken", "import no_such_module")
    install("other-nr", "other", HOOKS)
    folder = tmp_path / "run"
    folder.mkdir()
    with pytest.raises(NeuroroboError, match=r"the plugin acme-nr 0\.2 failed in `neurorobo_run_started`: TypeError: "):
        Registry.discover().call("neurorobo_run_started", folder=folder)
    assert [path.name for path in folder.iterdir()] == ["other"]


def test_registering_and_looking_up_imports_nothing_heavy() -> None:
    code = (
        "import sys; from neurorobo.plugins import Registry; Registry().plugins(); "
        "print(*{'torch', 'rerun', 'gymnasium', 'pint', 'pydantic'} & set(sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split() == []
