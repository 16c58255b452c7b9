"""Pages of the effects with every parameter, from the output of the command `effects`."""

from __future__ import annotations

import json
from typing import Any

from click.testing import CliRunner

from markup import split, table
from sgms_mhe.cli import cli
from sgms_mhe.model.effects import EFFECT_NAMES

HEAD = """# Effects, every parameter

One page per effect, made from the catalogue: the output of `sgms-mhe effects NAME`. [Effects](../docs/effects.md) says
what they are and how they are used; causes of a diagnosis that are no effects stand there too."""


def pages() -> dict[str, str]:
    """Return the Markdown of an overview and of every effect of this package, by address, in the catalogue's order."""
    effects = [_described(name) for name in EFFECT_NAMES]
    rows = [(effect["name"], _page(effect), f"Stage {effect['stage']}: {effect['summary']}") for effect in effects]
    return split("reference/effects.md", HEAD, ["effect", "stage and summary"], rows)


def _described(name: str) -> dict[str, Any]:
    done = CliRunner().invoke(cli, ["effects", name, "--json"], catch_exceptions=False)
    content: dict[str, Any] = json.loads(done.stdout)
    return content


def _page(effect: dict[str, Any]) -> str:
    rows = []
    for p in effect["parameters"]:
        named = [f"`{own}` [{p['units'][kind]}]" for kind, own in p["names"].items()]
        allowed = f"a list, each {p['allowed']}" if p["list"] else p["allowed"]
        rows.append([", ".join(dict.fromkeys(named)), p["meaning"], allowed, f"{p['default']:g}"])
    seen = effect["excitation"]
    parts = [
        f"# {effect['name']}",
        f"{effect['summary'][0].upper()}{effect['summary'][1:]}. Stage {effect['stage']}; "
        f"of an axis that is {' or '.join(effect['kinds'])}.",
        table(["parameter", "meaning", "allowed", "default"], rows),
        f"To be seen: {seen['text']}.",
        "\n".join(f"- {need}" for need in [*seen["needs"], *(f"move: {move}" for move in seen["moves"])]),
    ]
    if effect["confused_with"]:
        rivals = [[f"`{name}`", "; ".join(moves)] for name, moves in effect["confused_with"].items()]
        parts.append(table(["confused with", "distinguished by"], rivals))
    refusals = [f"`{other}`: together they cancel" for other in effect["excludes"]]
    refusals += [f'`law = "switching"`: {effect["not_with_switching"]}'] if effect["not_with_switching"] else []
    if refusals:
        parts.append("Not beside " + "; ".join(refusals) + ".")
    return "\n\n".join([*parts, f"```toml\n{effect['toml']}\n```"])
