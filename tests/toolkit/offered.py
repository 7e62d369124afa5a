"""A registry of the methods of a test, beside our own methods or alone."""

from __future__ import annotations

import p2o
import p2o_baselines.hooks
import p2o_datasets.hooks
import p2o_plugins.hooks
from p2o import Kind, Method, Registry


def registry_with(*offers: tuple[Kind, Method], alone: bool = False) -> Registry:
    """Return the registry of a plugin that offers these methods, and of our own unless it is `alone`."""
    methods = {kind: [method for its, method in offers if its == kind] for kind, _ in offers}
    hooks = {kind.hook: p2o.hookimpl(lambda self, its=its: its) for kind, its in methods.items()}
    ours = () if alone else (p2o_datasets.hooks, p2o_plugins.hooks, p2o_baselines.hooks)
    return Registry.of(*ours, type("Plugin", (), hooks)())
