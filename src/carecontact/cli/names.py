"""``carecontact list``: what can be named."""

from __future__ import annotations

from importlib import resources

from carecontact.protocols import load_protocol, shipped_protocols


def show(what: str, *, protocol: str) -> int:
    for kind in KINDS if what == "all" else [what]:
        if what == "all":
            print(f"{kind}:")
        for name, meaning in KINDS[kind](protocol):
            print(f"{'  ' if what == 'all' else ''}{name:24} {meaning}".rstrip())
    return 0


def _tasks(protocol: str) -> list[tuple[str, str]]:
    return [(task.id, f"{task.name}: {task.prompt!r}") for task in load_protocol(protocol).tasks]


def _policies(protocol: str) -> list[tuple[str, str]]:
    from carecontact.policies.registry import POLICIES

    rows = [(name, row.description) for name, row in POLICIES.items()]
    return [*rows, ("module:Class", "Your own, importable from the current folder.")]


def _protocols(protocol: str) -> list[tuple[str, str]]:
    loaded = {name: load_protocol(name) for name in shipped_protocols()}
    return [(name, f"{p.description} sha256 {p.sha256[:12]}") for name, p in loaded.items()]


def _bodies(protocol: str) -> list[tuple[str, str]]:
    folder = resources.files("carecontact") / "assets" / "bodies"
    return [(p.name.removesuffix(".npz"), "") for p in sorted(folder.iterdir(), key=str) if p.name.endswith(".npz")]


def _metrics(protocol: str) -> list[tuple[str, str]]:
    from carecontact.scoring import METRICS

    units = {name: "" if metric.unit == "1" else f" [{metric.unit}]" for name, metric in METRICS.items()}
    return [(name, f"{metric.title}{units[name]}, {metric.better} is better") for name, metric in METRICS.items()]


KINDS = {"tasks": _tasks, "policies": _policies, "protocols": _protocols, "bodies": _bodies, "metrics": _metrics}
