"""Plugins: what a package registers, and how it is found, loaded and kept from harming others."""

from neurorobo.plugins.hookspec import hookimpl
from neurorobo.plugins.registry import KINDS, Entry, Kind, PluginInfo, Registrar, Registry

__all__ = ["KINDS", "Entry", "Kind", "PluginInfo", "Registrar", "Registry", "hookimpl"]
