"""The commands that plugins register, by what is typed."""

from collections.abc import Collection

from neurorobo.plugins import Entry, Registry


def typed_name(entry: Entry) -> str:
    """Return what is typed: ``acme.make_coffee`` is ``make-coffee``."""
    return entry.name.partition(".")[2].replace("_", "-")


def plugin_commands(registry: Registry, taken: Collection[str]) -> dict[str, Entry]:
    """Return the commands that can be called; of two of one name the first plugin's by name, never one of ``taken``."""
    commands: dict[str, Entry] = {}
    for entry in registry.entries("command"):
        if typed_name(entry) not in taken:
            commands.setdefault(typed_name(entry), entry)
    return commands
