"""The figures for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def as_table(document: Mapping[str, Any]) -> str:
    """The document for people: a line on the machine, a table, what was left out."""
    machine = document["machine"]
    caches = ", ".join(f"{name} {size}" for name, size in machine["caches"].items())
    head = (
        f"{machine['processor']}, {machine['cores']} cores ({caches or 'caches unknown'}); "
        f"{machine['memory_bytes'] / 1e9:.0f} GB; "
        f"load at the start {machine['load_average'][0]:.2f}; "
        f"Python {machine['python']}, NumPy {machine['numpy']}, numba {machine['numba']}"
    )
    rows, groups = [("", "median", "min–max", "ratio", "min–max", "target")], []
    for figure in document["figures"]:
        value, ratio, yardstick = figure["value"], figure["ratio"], figure["yardstick"]
        scale, unit = _scaled(figure["unit"])
        scale_beside, unit_beside = _scaled(yardstick["unit"])
        quoted = "quoted" if yardstick["quoted"] else _range(yardstick, scale_beside)
        median = f"{scale_beside * yardstick['median']:.4g} {unit_beside}".rstrip()
        on = filter(None, (_words(figure["sizes"]), figure["dtype"]))
        groups.append(
            f"{', '.join(on)}, {figure['repeats']} repeats; "
            f"yardstick: {yardstick['name']}, {median} ({quoted})"
        )
        targets = figure["targets"]
        rows.append(
            (
                "  " + figure["name"],
                f"{scale * value['median']:.4g} {unit}",
                _range(value, scale),
                f"{ratio['median']:.3g}",
                _range(ratio),
                "; ".join(_judged(target, scale, unit) for target in targets),
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    title, *text = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    table = [title]
    for group, before, row in zip(groups, [None, *groups], text, strict=False):
        table += [row] if group == before else [group, row]
    left_out = [f"left out: {reason}" for reason in document["skipped"]]
    return "\n".join([head, "", *table, "", *left_out, f"took {document['seconds']:.0f} s"])


def _words(sizes: Mapping[str, Any]) -> str:
    if not sizes["shapes"]:
        return sizes["remark"]
    words = ", ".join(f"{cells:.3g}" for cells in sizes["cells"])
    if len(sizes["shapes"]) == 1:
        words = " × ".join(map(str, sizes["shapes"][0])) + f" = {sizes['cells'][0]}"
    return f"{words} cells" + (f", {sizes['remark']}" if sizes["remark"] else "")


def _scaled(unit: str) -> tuple[float, str]:
    """Factor and unit in which people read a rate."""
    if unit in ("cells/s", "void steps/s", "reads/s"):
        return 1e-6, f"M {unit}"
    return 1.0, unit


def _range(spread: Mapping[str, float], scale: float = 1.0) -> str:
    return f"{scale * spread['min']:.3g}–{scale * spread['max']:.3g}"


def _judged(target: Mapping[str, Any], scale: float, unit: str) -> str:
    bound = f"{target['bound']:.3g} of the yardstick"
    if target["of"] == "value":
        bound = f"{scale * target['bound']:.3g} {unit}".rstrip()
    return f"at {target['is']} {bound}: {'met' if target['met'] else 'missed'}"
